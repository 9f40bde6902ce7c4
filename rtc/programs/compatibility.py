"""Compatibility of the three programs: binder and analyzer must support each step of each script. Pure.

Works on typed documents. Each problem names a place in the elaborator's program.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from rtc.language.alike import unknown
from rtc.model.cells.parts import Numbers
from rtc.programs.extension_names import ARGS
from rtc.programs.schema import AnalyzerProgram, BinderProgram, ElaboratorProgram, ScriptStep

Problems = Iterator[tuple[str, str]]  # place, problem


class PlacedStep(Protocol):
    """A step of a script file or of a script."""

    @property
    def do(self) -> str: ...
    @property
    def op(self) -> str: ...
    @property
    def stop(self) -> str: ...


def row_of(step: PlacedStep) -> str:
    """The row of the analyzer's outcome table for a step: its stop class, else its action (`do-op`)."""
    return step.stop or "-".join(filter(None, (step.do, step.op)))


def misfits(elaborator: ElaboratorProgram, binder: BinderProgram, analyzer: AnalyzerProgram) -> Problems:
    """The steps that the binder could not bind or the analyzer could not assess, each with its place."""
    steps = {f"scripts[{n}]": script.steps for n, script in enumerate(elaborator.scripts)}
    steps |= {f"pieces[{n}]": piece.steps for n, piece in enumerate(elaborator.pieces)}
    for item, lines in steps.items():
        for n, step in enumerate(lines):
            yield from _step(step, f"{item}.steps[{n}]", binder, analyzer)


def _figures(binder: BinderProgram) -> set[str]:
    """The names that the args of a step may set: those of the binder's code and program, and of the cell."""
    classes = (name for row in binder.stop_classes.values() for name in row.values)
    return {*ARGS, *Numbers.__struct_fields__, *binder.values, *classes}


def _step(step: ScriptStep, place: str, binder: BinderProgram, analyzer: AnalyzerProgram) -> Problems:
    if step.do not in binder.actions:
        yield f"{place}.do", unknown("action of the binder", step.do, binder.actions)
        return
    algorithm = binder.actions[step.do]
    known = _figures(binder)
    for name in step.args:
        if name not in known:
            yield f"{place}.args.{name}", unknown("figure of a step", name, known)
    if (step.stop or algorithm in ("motion", "still")) and step.stop not in binder.stop_classes:
        yield f"{place}.stop", unknown("stop class", step.stop or "(none)", binder.stop_classes)
    if (step.op or algorithm == "hand") and step.op not in binder.hand:
        yield f"{place}.op", unknown("motion of the hand", step.op or "(none)", binder.hand)
    if algorithm == "procedure" and step.name not in binder.procedures:
        yield f"{place}.name", unknown("procedure", step.name or "(none)", binder.procedures)
    computes = {algorithm, binder.procedures.get(step.name, "")} & {*binder.computes}
    if not computes and row_of(step) not in analyzer.outcomes:
        yield place, unknown("row of the analyzer's outcomes", row_of(step), analyzer.outcomes)
