"""Poses and angles of an object that turns about a hinge through its origin. Pure geometry.

`home` is the pose of the object at angle 0 (world frame); `axis` is a unit vector in its axes. Angles are in rad.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats


def turned(home: Floats, axis: Floats, angle: float) -> Array:
    """The pose of the object at an angle."""
    half = 0.5 * angle
    return geometry.compose(home, (0.0, 0.0, 0.0, *(math.sin(half) * n for n in axis), math.cos(half)))


def angle_of(home: Floats, axis: Floats, pose: Floats) -> float:
    """The angle, from -pi to pi, at which the attitude of the object is nearest to that of `pose`."""
    x, y, z, w = geometry.relative(home, pose)[3:].tolist()
    found = 2.0 * math.atan2(x * axis[0] + y * axis[1] + z * axis[2], w)
    return math.remainder(found, math.tau)


def angle_at(home: Floats, axis: Floats, point: Floats, where: Floats) -> float:
    """The angle at which a point of the object is nearest to `where` (m, world frame).

    `point`: in the object's axes (m), not on the axis of the hinge.
    """
    x, y, z = geometry.transform_point(geometry.inverse(home), where).tolist()  # plain numbers: an array costs more
    (a, b, c), (p, q, r) = map(float, axis), map(float, point)
    sine = a * (q * z - r * y) + b * (r * x - p * z) + c * (p * y - q * x)
    return math.atan2(sine, p * x + q * y + r * z - (a * p + b * q + c * r) * (a * x + b * y + c * z))


def at_hand(home: Floats, axis: Floats, range_rad: tuple[float, float], point: Floats, where: Floats) -> Array:
    """The pose, between the stops, in which a point of the object is nearest to `where`; see `angle_at`."""
    least, most = range_rad
    return turned(home, axis, min(max(angle_at(home, axis, point, where), least), most))


def bar(points: Iterable[Floats], grasp: Floats) -> Array:
    """The point of a held object about which it turns in the hand (m, its axes). It is the one of `points` that is
    nearest to the tcp; without points it is at the tcp. `grasp`: the object's frame in that of the tcp."""
    nearest = min(points, key=lambda point: math.hypot(*geometry.transform_point(grasp, point)), default=None)
    return geometry.inverse(grasp)[:3] if nearest is None else np.asarray(nearest, dtype=float)


def in_hand(
    pose: Floats, angle: float, axis: Floats, range_rad: tuple[float, float], grasp: Floats, tcp: Floats, point: Floats
) -> Array:
    """The pose of a held object when its hand is at `tcp`. The hand may keep its attitude, and the object turn in it.

    `pose`: the object's frame at `angle`. `grasp`: its frame in that of the tcp, at any angle. `point`: about which it
    turns in the hand (m, its axes), see `bar`.
    """
    where = geometry.transform_point(tcp, geometry.transform_point(grasp, point))
    return at_hand(turned(pose, axis, -angle), axis, range_rad, point, where)


def frame(home: Floats, axis: Floats) -> Array:
    """A pose at the hinge whose z axis is the axis of the hinge."""
    along = np.asarray(axis, dtype=float)
    aside = np.eye(3)[int(np.abs(along).argmin())]
    matrix = np.eye(4)
    matrix[:3, 0] = np.cross(aside, along) / np.linalg.norm(np.cross(aside, along))
    matrix[:3, 1] = np.cross(along, matrix[:3, 0])
    matrix[:3, 2] = along
    return geometry.compose(home, geometry.from_matrix(matrix))
