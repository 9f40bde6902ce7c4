"""Attributes of objects as figures of programs (R105): `object.bar_width_m` is the fact `MACS-NEW.bar_width`. Pure.

`settable` of the elaborator's program declares the attribute with its unit, and SET states it. Only attributes of one
number are figures.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from rtc.programs import expressions
from rtc.programs.schema import BranchCondition, ElaboratorProgram, Expression, ScriptFile, ScriptPiece, ScriptStep
from rtc.protocol.units import SUFFIXES

PREFIX = "object."
PLAIN = "1"  # unit of a number without a unit


def figures(program: ElaboratorProgram) -> dict[str, str]:
    """The figures of the declared attributes: object.bar_width_m -> bar_width."""
    rows = ((name, row) for name, row in program.settable.items() if len(row.of) == 1 and row.unit)
    return {PREFIX + "_".join(filter(None, (name, SUFFIXES.get(row.unit, "")))): name for name, row in rows}


def of_script(script: ScriptFile, pieces: Mapping[str, ScriptPiece]) -> list[str]:
    """The attributes that a script uses, with those of its pieces. `pieces`: by skill."""
    own = [pieces[entry.skill] for entry in script.trimming_stack if entry.skill in pieces]
    steps = [*script.steps, *(step for piece in own for step in piece.steps)]
    used = [*(line.by for line in script.plan), *(line.turn_rad for line in script.plan), *_of_steps(steps)]
    conditions = [script.unsure_if] if script.unsure_if is not None else []
    return sorted({*_among(used), *of_conditions(conditions)})


def of_values(values: Iterable[Expression]) -> set[str]:
    return set(_among(values))


def of_conditions(conditions: Iterable[BranchCondition]) -> set[str]:
    return set(_among(bound for one in conditions for bound in (one.of, one.at_least, one.at_most)))


def _of_steps(steps: Iterable[ScriptStep]) -> Iterator[Expression]:
    for step in steps:
        yield from step.args.values()


def _among(texts: Iterable[Expression | None]) -> Iterator[str]:
    """Attributes in these expressions; most have none, so they are not parsed."""
    for text in texts:
        if isinstance(text, str) and PREFIX in text:
            yield from (name for name in expressions.names(text) if name.startswith(PREFIX))
