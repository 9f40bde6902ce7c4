"""Named axes, and poses shifted along or turned about them. Pure geometry, independent of the robot."""

from __future__ import annotations

import math

from rtc.spatial import geometry
from rtc.spatial.axis_names import AXES
from rtc.spatial.geometry import Array, Floats


def name_of(direction: Floats) -> str:
    """Name of the nearest of the six world directions: UP, BACK and so on."""
    words = ("UP", "DOWN", "LEFT", "RIGHT", "FORWARD", "BACK")
    return max(words, key=lambda word: sum(a * b for a, b in zip(AXES[word][1], direction, strict=True)))


def shifted(pose: Floats, axis: str, by_m: float) -> Array:
    """`pose` (world frame) shifted along a named axis. Raises KeyError for an unknown name."""
    owner, vector = AXES[axis]
    step = [by_m * n for n in vector]
    return geometry.translate(pose, geometry.rotate(pose, step) if owner == "tool" else step)


def turned(pose: Floats, axis: str, by_rad: float) -> Array:
    """`pose` (world frame) turned in place about a named axis. Raises KeyError for an unknown name."""
    owner, vector = AXES[axis]
    half = 0.5 * by_rad
    turn = (0.0, 0.0, 0.0, *(math.sin(half) * n for n in vector), math.cos(half))
    here = list(pose)
    if owner == "tool":
        return geometry.compose(here, turn)
    return geometry.make_pose(here[:3], geometry.compose(turn, (0.0, 0.0, 0.0, *here[3:]))[3:])


def direction(pose: Floats, axis: str) -> list[float]:
    """Unit vector (world) of a named axis; a TOOL axis is one of `pose`."""
    owner, vector = AXES[axis]
    return geometry.rotate(pose, vector).tolist() if owner == "tool" else list(vector)


def in_tool(pose: Floats, axis: str) -> list[float]:
    """Unit vector of a named axis in the tool frame of `pose`."""
    owner, vector = AXES[axis]
    return list(vector) if owner == "tool" else geometry.rotate(geometry.inverse(pose), vector).tolist()
