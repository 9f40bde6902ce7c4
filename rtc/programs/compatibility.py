"""Compatibility of the three programs: binder and analyzer must support each step of each script. Pure.

Works on typed documents. Each problem names a place in the elaborator's program.
"""

from __future__ import annotations

from rtc.programs import step_kinds
from rtc.programs.checks import PlacedStep, Problems, known, steps_of
from rtc.programs.schema import AnalyzerProgram, BinderProgram, ElaboratorProgram, ScriptStep
from rtc.protocol.messages import GripStep, InstalledStep, ProcedureStep, Step
from rtc.protocol.outcomes import OF_OPERATOR


def row_of(step: ScriptStep | Step) -> str:
    """The row of the analyzer's outcome table for a step: its stop class, else its action (`do-op`)."""
    return step.stop or "-".join(filter(None, (step.do, step.op)))


PLAIN = ScriptStep(do="let")


def computes(step: ScriptStep, binder: BinderProgram) -> bool:
    """Whether a step yields bindings, without motion."""
    return bool({step.do, binder.procedures.get(step.name, "")} & {*binder.computes})


def misfits(elaborator: ElaboratorProgram, binder: BinderProgram, analyzer: AnalyzerProgram) -> Problems:
    """The steps that the binder could not bind or the analyzer could not assess, each with its place."""
    pieces = {piece.skill for piece in elaborator.pieces}
    for n, rule in enumerate(analyzer.rules):
        yield from known("piece", rule.trim, pieces, f"rules[{n}].trim of the analyzer")
    for skill in analyzer.search.pieces if analyzer.search else ():
        yield from known("piece", skill, pieces, f"search.pieces.{skill} of the analyzer")
    for placed in steps_of(elaborator):
        yield from _step(placed, binder, analyzer)


def _step(placed: PlacedStep, binder: BinderProgram, analyzer: AnalyzerProgram) -> Problems:
    place, step = placed.place, placed.step
    kind = step_kinds.kind_of(step)
    assert kind is not None, step.do  # others were refused
    figures = step_kinds.figures_of(kind) | step_kinds.values_of(kind, step_kinds.stop_rows(step, kind, binder))
    for name in step.args if kind is not InstalledStep else ():  # the worker that has the package knows them
        yield from known("figure of a step", name, figures, f"{place}.args.{name}")
    if step.stop:
        yield from known("stop class", step.stop, binder.stop_classes, f"{place}.stop")
    if kind is GripStep:
        yield from known("motion of the hand", step.op, binder.hand, f"{place}.op")
    if kind is ProcedureStep:
        yield from known("procedure", step.name, binder.procedures, f"{place}.name")
    if computes(step, binder):
        for part in ("args", "words", "keep", "expect"):
            if getattr(step, part) != getattr(PLAIN, part):
                yield f"{place}.{part}", f"a step that moves nothing does not read {part}: leave it out"
    else:
        yield from known("row of the analyzer's outcomes", row_of(step), analyzer.outcomes, place)
    lacks = sorted(OF_OPERATOR - analyzer.outcomes.get(row_of(step), {}).keys())
    if step.do == "operate" and row_of(step) in analyzer.outcomes and lacks:
        yield place, f"the row {row_of(step)} of the analyzer's outcomes has no cell for {', '.join(lacks)}"
