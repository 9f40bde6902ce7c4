"""Directions by name, and poses moved along or about them. Pure geometry; knows no robot."""

from __future__ import annotations

import math

from rtc import geometry
from rtc.axis_names import AXES
from rtc.geometry import Array, Floats


def name_of(direction: Floats) -> str:
    """The word for a direction in world axes: UP, BACK, ...; of the six, the one it is nearest to."""
    words = ("UP", "DOWN", "LEFT", "RIGHT", "FORWARD", "BACK")
    return max(words, key=lambda word: sum(a * b for a, b in zip(AXES[word][1], direction, strict=True)))


def shifted(pose: Floats, axis: str, by_m: float) -> Array:
    """`pose` (world) moved along an axis of the table. KeyError for another name."""
    owner, vector = AXES[axis]
    step = [by_m * n for n in vector]
    return geometry.translate(pose, geometry.rotate(pose, step) if owner == "tool" else step)


def turned(pose: Floats, axis: str, by_rad: float) -> Array:
    """`pose` (world) turned on the spot about an axis of the table."""
    owner, vector = AXES[axis]
    half = 0.5 * by_rad
    turn = (0.0, 0.0, 0.0, *(math.sin(half) * n for n in vector), math.cos(half))
    here = list(pose)
    if owner == "tool":
        return geometry.compose(here, turn)
    return geometry.make_pose(here[:3], geometry.compose(turn, (0.0, 0.0, 0.0, *here[3:]))[3:])


def in_tool(pose: Floats, axis: str) -> list[float]:
    """The unit vector of an axis, in the tool's axes."""
    owner, vector = AXES[axis]
    return list(vector) if owner == "tool" else geometry.rotate(geometry.inverse(pose), vector).tolist()
