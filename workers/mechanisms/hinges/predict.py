"""When a path about a hinge reaches its goal: where the tcp has turned as far as the step says. Pure."""

from __future__ import annotations

import numpy as np

from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import JointTrajectory, Primitive, TurnAbove
from rtc.spatial.geometry import Array
from workers.planning.world_query import WorldQuery
from workers.tasks.report import curve

TURN_TIMES = 201  # of a path, at which its turn is evaluated


def turned_s(query: WorldQuery, made: Primitive) -> float | None:
    """When the tcp has turned round a hinge as far as a stop function says; None if none does, or not on this path.

    Friction keeps a compliant arm behind its command, so the path leads farther (`lag_rad` of the scripts)."""
    path = made.trajectory
    assert isinstance(path, JointTrajectory)
    for stop in made.stop_functions:
        when = stop.when
        if stop.reason is not StopReason.GOAL or not isinstance(when, TurnAbove) or when.point is None:
            continue
        times = np.linspace(0.0, path.duration_s, TURN_TIMES)
        places = [query.model.arms[made.performer].fk(joints)[:3] for joints in curve(path).at(times)[:, 0]]
        turned = _round_axis(np.array(places) - when.point, np.array(when.axis))
        past = np.flatnonzero(turned > when.limit_rad)
        if len(past) > 0:
            before, after = turned[past[0] - 1], turned[past[0]]
            share = (when.limit_rad - before) / (after - before)
            return float(times[past[0] - 1] + share * (times[past[0]] - times[past[0] - 1]))
    return None


def _round_axis(arms: Array, axis: Array) -> Array:
    """The turn (rad, either way) about an axis from the first of these lever arms to each, [n]; whole turns count."""
    along = axis / np.linalg.norm(axis)
    first = arms[0] - along * float(along @ arms[0])
    angles = np.arctan2(arms @ np.cross(along, first), arms @ first)
    return np.abs(np.unwrap(angles))
