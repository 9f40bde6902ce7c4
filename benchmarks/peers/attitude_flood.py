"""All postures that an arm can move to while its hand keeps an attitude: a flood over a grid of its first three joints.

It shows that a goal has no way, where a search only has not found one. For an arm with a spherical wrist: the first
three joints and the attitude determine the wrist, in two branches. The axes of the tool are those of the wrist, as in
the cell `swapout`. The flood goes farther than the arm can: the wrist passes its limits by `BEYOND_RAD`, and a straight
wrist turns freely, because an attitude has a tolerance.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from functools import cache

import numpy as np

from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.planning.motion.request import PlanningRequest, free_posture

STEP_RAD = math.radians(5.0)  # of the grid
BEYOND_RAD = math.radians(8.0)
STRAIGHT_RAD = math.radians(10.0)  # of joint 5
TURN_RAD = math.radians(40.0)  # maximum displacement of a joint of the wrist between two neighbours of the grid
FOUND_RAD = math.radians(45.0)  # a posture as near as this to a goal counts as the goal
TURN = 2 * math.pi
STEPS = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]


def has_way(request: PlanningRequest, goals: list[Array]) -> bool:
    """Whether the flood from the start comes near one of these goals (rad)."""
    start, test, ends = request.start, free_posture(request), np.array(goals)
    lower, upper = request.arm.limits.lower.copy(), request.arm.limits.upper.copy()
    lower[3:] -= BEYOND_RAD
    upper[3:] += BEYOND_RAD
    wrists = cache(lambda cell: _wrists(request, start[:3] + STEP_RAD * np.array(cell)))
    seen = {((0, 0, 0), *_branch(start))}
    todo = deque([((0, 0, 0), start)])
    while todo:
        cell, near = todo.popleft()
        if np.abs(ends - near).max(axis=1).min() < FOUND_RAD:
            return True
        for step in STEPS:
            there = (cell[0] + step[0], cell[1] + step[1], cell[2] + step[2])
            for q in _beside(wrists(there), near):
                key = (there, *_branch(q))
                if key not in seen and bool((q >= lower).all() and (q <= upper).all()) and test(q) is None:
                    seen.add(key)
                    todo.append((there, q))
    return False


def _branch(q: Array) -> tuple[int, int, bool]:
    """What tells postures with the same first three joints apart: turns of the wrist, and its side."""
    return round(2 * q[3]), round(2 * q[5]), bool(q[4] > 0)


def _wrists(request: PlanningRequest, first: Array) -> Array:
    """The postures with these first three joints that keep the attitude, [2][joints]."""
    attitude = request.path_constraints.attitude
    assert attitude is not None
    straight = request.arm.fk(np.concatenate((first, np.zeros(3))))
    w = geometry.to_matrix(straight)[:3, :3].T @ geometry.to_matrix(attitude.pose)[:3, :3]
    q4, q5 = math.atan2(-w[1, 2], -w[0, 2]), math.atan2(math.hypot(w[0, 2], w[1, 2]), w[2, 2])
    q6 = math.atan2(-w[2, 1], w[2, 0])
    return np.array([[*first, q4, q5, q6], [*first, q4 + math.pi, -q5, q6 + math.pi]])


def _beside(postures: Array, near: Array) -> Iterator[Array]:
    """Those of these postures, with the nearest turns of their wrists, that can be reached from a posture beside."""
    for posture in postures:
        q = posture.copy()
        q[3:] -= TURN * np.round((q - near)[3:] / TURN)
        loose = max(abs(q[4]), abs(near[4])) < STRAIGHT_RAD
        if loose or np.abs(q - near)[3:].max() <= TURN_RAD:
            yield q
