"""Rows that the command-object table lacks, computed by fillers of packages (`rtc.fillers`, R89). Pure if they are.

function(verb: str, thing: Object | None, figures: dict[str, float]) -> figures by name, or None: no row
"""

from __future__ import annotations

import copy
import math
from typing import Any, NamedTuple

from rtc.model.cells import parts
from rtc.plugins import registry
from rtc.programs.schema import ElaboratorProgram

MOST_FIGURES = 100  # of one row


class TableFigures(NamedTuple):
    """The figures of one row of the command-object table."""

    values: dict[str, float]
    filler: str = ""  # who has computed it; empty: the program states it


def filled(
    program: ElaboratorProgram, verb: str, thing: parts.Object | None, given: dict[str, float]
) -> TableFigures | None:
    """The row of the first filler of the program that has one. `given`: numbers of the cell, attributes of the object.

    Raises PluginError."""
    for name in program.fillers:
        with registry.guarded(registry.FILLERS, name):
            answer = registry.installed(registry.FILLERS)[name](verb, copy.deepcopy(thing), dict(given))
            values = None if answer is None else _checked(answer)
        if values is not None:
            return TableFigures(values, name)
    return None


def _checked(answer: Any) -> dict[str, float]:
    """What a filler has returned, as plain numbers. Raises ValueError and others."""
    values = {str(name): float(value) for name, value in dict(answer).items()}
    if len(values) > MOST_FIGURES or not all(math.isfinite(value) for value in values.values()):
        raise ValueError(f"expected are at most {MOST_FIGURES} finite figures")
    return values
