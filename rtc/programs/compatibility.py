"""Compatibility of the three programs: binder and analyzer must support each step of each script. Pure.

Works on typed documents. Each problem names a place in the elaborator's program.
"""

from __future__ import annotations

from rtc.model.cells.parts import Numbers
from rtc.programs.checks import PlacedStep, Problems, known, steps_of
from rtc.programs.schema import AnalyzerProgram, BinderProgram, ElaboratorProgram, ScriptStep
from rtc.protocol.messages import Step, StepFigures
from rtc.protocol.outcomes import OF_OPERATOR


def row_of(step: ScriptStep | Step) -> str:
    """The row of the analyzer's outcome table for a step: its stop class, else its action (`do-op`)."""
    return step.stop or "-".join(filter(None, (step.do, step.op)))


def misfits(elaborator: ElaboratorProgram, binder: BinderProgram, analyzer: AnalyzerProgram) -> Problems:
    """The steps that the binder could not bind or the analyzer could not assess, each with its place."""
    classes = (name for row in binder.stop_classes.values() for name in row.values)
    figures = {
        *StepFigures.__struct_fields__,
        *Numbers.__struct_fields__,
        *binder.values,
        *classes,
    }  # that the args of a step may set
    pieces = {piece.skill for piece in elaborator.pieces}
    for n, rule in enumerate(analyzer.rules):
        yield from known("piece", rule.trim, pieces, f"rules[{n}].trim of the analyzer")
    for skill in analyzer.search.pieces if analyzer.search else ():
        yield from known("piece", skill, pieces, f"search.pieces.{skill} of the analyzer")
    for placed in steps_of(elaborator):
        yield from _step(placed, figures, binder, analyzer)


def _step(placed: PlacedStep, figures: set[str], binder: BinderProgram, analyzer: AnalyzerProgram) -> Problems:
    place, step = placed.place, placed.step
    yield from known("action of the binder", step.do, binder.actions, f"{place}.do")
    algorithm = binder.actions.get(step.do, "")
    for name in step.args:
        yield from known("figure of a step", name, figures, f"{place}.args.{name}")
    if step.stop or algorithm in ("motion", "still"):
        yield from known("stop class", step.stop or "(none)", binder.stop_classes, f"{place}.stop")
    if step.op or algorithm == "hand":
        yield from known("motion of the hand", step.op or "(none)", binder.hand, f"{place}.op")
    if algorithm == "procedure":
        yield from known("procedure", step.name or "(none)", binder.procedures, f"{place}.name")
    if not {algorithm, binder.procedures.get(step.name, "")} & {*binder.computes}:
        yield from known("row of the analyzer's outcomes", row_of(step), analyzer.outcomes, place)
    lacks = sorted(OF_OPERATOR - analyzer.outcomes.get(row_of(step), {}).keys())
    if algorithm == "operated" and row_of(step) in analyzer.outcomes and lacks:
        yield place, f"the row {row_of(step)} of the analyzer's outcomes has no cell for {', '.join(lacks)}"
