"""Upper bounds of how far a body moves when joints turn: its levers. Pure.

A lever is the greatest distance (m) of any point of a body from a joint's axis, at any joint values. A turn of that
joint by dq (rad) moves no point of the body farther than lever * dq.
"""

from __future__ import annotations

import math
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin

from rtc.spatial.geometry import Array, Floats


def levers(model: pin.Model, joint: int, centre: Floats, radius_m: float) -> Array:
    """The levers of a ball that is fixed to a joint, for each value of the configuration; 0: it does not move the ball.

    `centre`: of the ball, in the axes of the joint (m). A joint that slides has the lever 1 (m per m).
    """
    found = np.zeros(model.nq)
    point = np.asarray(centre, dtype=float)
    far_m = float(np.linalg.norm(point))
    for kind, at, most_m, place, place_m in _to_base(model, joint):
        if kind == "JointModelRZ":
            found[at] = math.hypot(point[0], point[1]) + radius_m
        elif kind.startswith("JointModelR"):
            found[at] = far_m + radius_m
        else:
            found[at] = 1.0
            radius_m += most_m
        radius_m += far_m
        point, far_m = place, place_m
    return found


@lru_cache(maxsize=256)
def _to_base(model: pin.Model, joint: int) -> list[tuple[str, int, float, Array, float]]:
    """Of a joint and those that carry it: kind, index and greatest size of its value, place before it turns, and the
    distance (m) of that."""
    found = []
    while joint > 0:
        kind, at = model.joints[joint].shortname(), model.joints[joint].idx_q
        most = max(abs(model.lowerPositionLimit[at]), abs(model.upperPositionLimit[at]))
        place = np.array(model.jointPlacements[joint].translation)
        found.append((kind, at, most, place, float(np.linalg.norm(place))))
        joint = model.parents[joint]
    return found


def ball(solid: coal.CollisionGeometry, at: pin.SE3) -> tuple[Array, float]:
    """Centre and radius (m) of a ball around a solid that is placed at `at`."""
    solid.computeLocalAABB()
    return at.act(np.asarray(solid.aabb_center)), float(solid.aabb_radius)


def of_pairs(levers_a: Array, levers_b: Array) -> Array:
    """The levers of the distance between two bodies each, [pairs][joints].

    A joint that moves both bodies does not change their distance.
    """
    both = (levers_a > 0) & (levers_b > 0)
    return np.where(both, 0.0, levers_a + levers_b)
