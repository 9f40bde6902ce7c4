"""Curves of the hand: circles about an axis, and search patterns in a plane. Pure.

A curve is a table of tcp poses in world axes, [poses][7], from the pose where it begins. The names are spaces of a
script's steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from rtc.protocol.causes import BadCurve
from rtc.protocol.messages import CircleStep, PatternStep
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial import geometry
from rtc.spatial.axis_names import AXES
from rtc.spatial.geometry import Array, Floats
from workers.planning import axes, suggestions
from workers.planning.motion.path import KNOT_M

MAX_POSES = 4000  # maximum number of poses of one curve
CIRCLE_RAD = 0.04  # maximum turn between two poses of a circle; the hand then keeps its radius to some 0.05 mm
PATTERN_RAD = 0.2  # maximum turn between two poses of a pattern


def circle(step: CircleStep, start: Floats, about: Floats, axis: str) -> Array:
    """A turn by `by_rad` about the axis, with a rise of `by_m` along it, from the tcp pose `start`. The axis passes
    through the origin of the pose `about`; a TOOL axis is an axis of that pose. `hand_turn`: share of the turn that the
    hand makes with it: 1 (default) as if fixed to the hinge, 0 with its attitude kept.

    All poses are in world axes. Raises Refused for impossible figures.
    """
    _refuse_unknown(axis)
    start, about = np.asarray(start, dtype=float), np.asarray(about, dtype=float)
    by_rad, by_m, share = step.by_rad, step.by_m, step.hand_turn
    if not abs(by_rad) > 1e-6 or not math.isfinite(by_rad + by_m):
        raise _refused(f"a circle by {by_rad:g} rad has no direction", "by_rad other than 0")
    if not 0.0 <= share <= 1.0:
        raise _refused(f"hand_turn {share:g} is not a share of the turn", "hand_turn of 0 to 1")
    along = np.array(axes.direction(about, axis))
    arm = start[:3] - about[:3]
    arm = arm - along * float(arm @ along)
    count = _count(abs(by_rad) * float(np.linalg.norm(arm)) / KNOT_M, abs(by_rad) / CIRCLE_RAD, abs(by_m) / KNOT_M)
    poses = []
    for fraction in np.linspace(0.0, 1.0, count + 1).tolist():
        angle = fraction * by_rad
        turned = arm * math.cos(angle) + np.cross(along, arm) * math.sin(angle)
        position = start[:3] + (turned - arm) + fraction * by_m * along
        poses.append(geometry.make_pose(position, _turned(start, along, share * angle)))
    return np.array(poses)


def pattern(step: PatternStep, start: Floats, axis: str) -> Array:
    """A search that begins at the tcp pose `start`, in the plane whose normal is the axis; a TOOL axis is an axis of
    the hand. It advances by `by_m` along the normal in all. Raises Refused for impossible figures."""
    _refuse_unknown(axis)
    radius, pitch = step.radius_m, step.pitch_m
    if not 0.0 < pitch <= radius < math.inf:  # false for nan too
        raise _refused(
            f"a pattern with a radius of {radius:g} m and a pitch of {pitch:g} m covers nothing",
            "pitch_m above 0 and at most radius_m",
        )
    return _in_plane(np.asarray(start, dtype=float), axis, PATTERNS[step.space](radius, pitch), step.by_m)


def _spiral(radius: float, pitch: float) -> Array:
    """From the hand outwards to the radius, with the pitch between turns."""
    turns = radius / pitch
    count = _count(math.tau * turns / PATTERN_RAD)
    angle = np.linspace(0.0, math.tau * turns, count + 1)
    plane: Array = np.stack((np.cos(angle), np.sin(angle)), axis=1) * (pitch * angle / math.tau)[:, None]
    return plane


def _raster(radius: float, pitch: float) -> Array:
    """Lines back and forth at a distance of the pitch, joined by half circles, over a square whose half side is the
    radius, round the hand. The path begins in the middle and goes to a corner first."""
    lines = 2 * math.ceil(radius / pitch) + 1
    half_turn = math.ceil(math.pi / PATTERN_RAD)
    per_line = max(8, math.ceil(2.0 * radius / KNOT_M))
    _count((lines + 1) * (half_turn + per_line))
    corner = np.array((-radius, -0.5 * (lines - 1) * pitch))
    rows = [_bend((np.zeros(2), 0.5 * corner, corner - (pitch, 0.0), corner), half_turn)]
    side = -1.0
    for n in range(lines):
        y = (n - 0.5 * (lines - 1)) * pitch
        rows.append(np.linspace((side * radius, y), (-side * radius, y), per_line + 1))
        side = -side
        if n < lines - 1:
            angle = np.linspace(0.0, math.pi, half_turn, endpoint=False)[1:]
            bend = np.stack((side * np.sin(angle), 1.0 - np.cos(angle)), axis=1) * 0.5 * pitch
            rows.append(bend + np.array((side * radius, y)))
    return np.concatenate(rows)


def _bend(corners: tuple[Array, Array, Array, Array], count: int) -> Array:
    """A cubic Bezier curve, without its last point, so that the hand enters the first line along it."""
    t = np.linspace(0.0, 1.0, count, endpoint=False)[:, None]
    a, b, c, d = corners
    found: Array = (1 - t) ** 3 * a + 3 * t * (1 - t) ** 2 * b + 3 * t * t * (1 - t) * c + t**3 * d
    return found


def _in_plane(start: Array, axis: str, plane: Array, by_m: float) -> Array:
    """The poses at these points (m) of a plane through the hand, with its attitude."""
    normal = np.array(axes.direction(start, axis))
    aside = np.eye(3)[int(np.abs(normal).argmin())]
    first = np.cross(normal, aside)
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    along = np.concatenate(((0.0,), np.cumsum(np.linalg.norm(np.diff(plane, axis=0), axis=1))))
    rise = np.outer(along * (by_m / along[-1]), normal)
    poses = np.tile(start, (len(plane), 1))
    poses[:, :3] += plane @ np.stack((first, second)) + rise
    return poses


def _turned(start: Array, along: Array, angle: float) -> list[float]:
    turn = (0.0, 0.0, 0.0, *(math.sin(0.5 * angle) * along).tolist(), math.cos(0.5 * angle))
    attitude: list[float] = geometry.compose(turn, (0.0, 0.0, 0.0, *start[3:].tolist()))[3:].tolist()
    return attitude


def _count(*wanted: float) -> int:
    count = max(4, *(math.ceil(n) for n in wanted))
    if count <= MAX_POSES:
        return count
    message = f"the curve would have {count} knots; {MAX_POSES} is the maximum"
    raise _refused(message, "a smaller one, or a wider pitch")


def _refused(message: str, clears: str) -> Refused:
    return Refused.because(RefusalReason.INFEASIBLE, message, clears=clears, cause=BadCurve())


def _refuse_unknown(axis: str) -> None:
    if axis not in AXES:
        raise suggestions.unknown("axis", axis, AXES)


#: space of a step -> the points of its pattern in the plane, from radius and pitch (m)
PATTERNS: dict[str, Callable[[float, float], Array]] = {"move_spiral": _spiral, "move_raster": _raster}
