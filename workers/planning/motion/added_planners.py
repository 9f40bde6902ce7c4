"""Path planners of installed packages (`rtc.planners`), asked before the search by sampling. Pure if they are.

    function(request: PlanningRequest, goal: Array) -> way-points (rad, [points][joints]) from start to goal, or None

A planner cannot make a colliding path accepted: its corners are rounded and judged as those of our own search.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from rtc.plugins import registry
from rtc.plugins.guard import PluginError
from rtc.spatial.geometry import Array
from workers.planning.motion.path import Path
from workers.planning.motion.request import FreeWay, PlanningRequest

MOST_CORNERS, MOST_RAD = 1_000, 300.0  # way-points of one planner, and the way of the joint that turns most
END_RAD = 1e-6  # tolerance of the first and last way-point, and beyond a joint limit

Judge = Callable[[PlanningRequest, list[Array]], Path | None]  # the rounded way, if it is free


def find_way(request: PlanningRequest, goal: Array, judge: Judge) -> tuple[FreeWay | None, list[str]]:
    """The first free way of a planner, in the order of their names; and a note for each that was asked."""
    notes: list[str] = []
    for name, plan in registry.installed(registry.PLANNERS).items():
        corners, problem = _corners(name, plan, request, goal)
        way = judge(request, corners) if corners else None
        notes.append(f"planner {name}: {problem or ('tested: free' if way is not None else 'tested: not free')}")
        if way is not None:
            return FreeWay(way, notes), notes
    return None, notes


def _corners(name: str, plan: Any, request: PlanningRequest, goal: Array) -> tuple[list[Array], str]:
    """The way-points of one planner, or why they are none."""
    try:
        with registry.guarded(registry.PLANNERS, name):
            found = plan(_copied(request), goal.copy())
            if found is None:
                return [], "found no way"
            points = np.asarray(found, dtype=float)
    except PluginError as error:
        return [], error.problem
    right = points.ndim == 2 and 2 <= points.shape[0] <= MOST_CORNERS and points.shape[1] == len(goal)
    if not right or not np.isfinite(points).all():
        wanted = f"finite joint values, [2 to {MOST_CORNERS}][{len(goal)}]"
        return [], f"way-points of shape {points.shape}; expected are {wanted}"
    if np.abs(points[0] - request.start).max() > END_RAD or np.abs(points[-1] - goal).max() > END_RAD:
        return [], "its way does not lead from the start to the goal"
    if (beyond := -request.arm.limit_margin_rad(points)) > END_RAD:
        return [], f"its way leads {beyond:.3g} rad beyond a joint limit"
    if (turned := float(np.abs(np.diff(points, axis=0)).max(axis=1).sum())) > MOST_RAD:
        return [], f"its way is {turned:.3g} rad long; {MOST_RAD:g} are allowed"
    return [request.start, *points[1:-1], goal], ""


def _copied(request: PlanningRequest) -> PlanningRequest:
    """With joint values of its own: what a planner changes in them is not where the arm stands."""
    joints = {arm: np.array(values, dtype=float) for arm, values in request.joints.items()}
    return msgspec.structs.replace(request, joints=joints)
