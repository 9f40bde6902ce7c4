"""Places taught on the spot: postures of arms, in the world as facts PLACE.posture_of_ARM. Pure.

Values are in rad, and in m for a joint that slides. `taught_file` keeps them for the next runs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from rtc.language.stands_for import stands_for_something
from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Place
from rtc.spatial.axis_names import AXES

POSTURE = "posture_of_"
WORLD = "WORLD"  # stands for the whole world in SET

Postures = dict[str, dict[str, list[float]]]  # place -> arm -> joint values


def key_of(place: str, arm: str) -> str:
    return f"{place}.{POSTURE}{arm.lower().replace('-', '_')}"


def arm_of(attribute: str) -> str:
    """RIGHT-ARM of posture_of_right_arm; empty for another attribute."""
    return attribute.removeprefix(POSTURE).upper().replace("_", "-") if attribute.startswith(POSTURE) else ""


def postures(values: Iterable[tuple[str, Any]]) -> Postures:
    """Those among facts (key, value); a forgotten one has the value None."""
    found: Postures = {}
    for key, value in values:
        place, _, attribute = key.partition(".")
        if value and (arm := arm_of(attribute)):
            found.setdefault(place, {})[arm] = [float(n) for n in value]
    return found


def as_places(cell: Cell, known: Postures) -> list[Place]:
    """As parts of the cell, in the units of a cell file."""
    slides = {arm.name: [isinstance(value, str) for value in arm.home_deg] for arm in cell.arms}
    return [
        Place(
            name=name,
            joints_deg={
                arm: [
                    f"{value!r} m" if slide else math.degrees(value)
                    for value, slide in zip(joints, slides[arm], strict=True)
                ]
                for arm, joints in by_arm.items()
            },
        )
        for name, by_arm in known.items()
    ]


def taken(cell: Cell, name: str) -> str:
    """What has this name already, so that no place can be taught under it; empty if nothing has."""
    if name in (WORLD, *AXES):
        return "an axis" if name in AXES else "the whole world"
    if stands_for_something(name):
        return "a word of the command language"
    kinds: Mapping[str, Iterable[Any]] = {
        "an arm": cell.arms,
        "a seat": cell.seats,
        "an object": cell.objects,
        "a place of the cell file": cell.places,
        "a region": cell.regions,
        "a camera": cell.cameras,
    }
    return next(
        (kind for kind, parts in kinds.items() if any(part.name == name for part in parts)),
        "the name of a part" if name in (*cell.names(), *cell.attitudes) else "",
    )
