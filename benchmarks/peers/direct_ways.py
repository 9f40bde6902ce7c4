"""Peer of `benchmarks.planning`: the direct ways alone, as before the sampling planner.

A line in joint space, a straight line of the hand, and up to 24 splines with the hand raised or drawn back.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rtc.protocol.outcomes import Refused
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.planning.motion import path as paths
from workers.planning.motion import plan
from workers.planning.motion.path import Path
from workers.planning.motion.request import PlanningRequest, fault

RAISE_M, BACK_M = (0.0, 0.15, 0.30), (0.0, 0.10, 0.20)


def find(request: PlanningRequest, goal: Array) -> Path | None:
    """The first direct way that is free."""
    return next((way for way in _ways(request, goal) if fault(request, way) is None), None)


def _ways(request: PlanningRequest, goal: Array) -> Iterator[Path]:
    yield paths.joint_line(request.start, goal)
    try:
        straight = paths.task_line(request.arm, request.start, request.arm.fk(goal), request.way_margin_rad)
    except Refused:
        pass
    else:
        if np.abs(straight.knots[-1] - goal).max() < plan.SAME_RAD:
            yield straight
    ends = [(request.arm.fk(q), q) for q in (request.start, goal)]
    for back in BACK_M:
        for up in RAISE_M:
            moved = [
                geometry.translate(geometry.compose(pose, (0, 0, -back, 0, 0, 0, 1)), (0, 0, up)) for pose, _ in ends
            ]
            first, second = (request.arm.nearest_ik(pose, q) for pose, (_, q) in zip(moved, ends, strict=True))
            if back == up == 0.0 or first is None or second is None:
                continue
            yield paths.spline_through([request.start, first, second, goal])
            yield paths.spline_through([request.start, first, goal])
            yield paths.spline_through([request.start, second, goal])
