"""Who finds a free way to joint values: the planners of the program, one after the other. Pure if they are.

    function(request: PlanningRequest, goal: Array) -> way-points (rad, [points][joints]) from start to goal, or None

A planner of a package (`rtc.planners`) cannot make a colliding path accepted: its corners are rounded and judged as
those of our own search.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np

from rtc.plugins import registry
from rtc.plugins.guard import PluginError
from rtc.programs.schema import OWN
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial.geometry import Array
from workers.planning.motion.request import FreeWay, PlanningRequest
from workers.planning.motion.sampled_way import rounded

MOST_CORNERS, MOST_RAD = 1_000, 300.0  # way-points of one planner, and the way of the joint that turns most
END_RAD = 1e-6  # tolerance of the first and last way-point, and beyond a joint limit


def find_way(request: PlanningRequest, goal: Array, own: Callable[[], FreeWay]) -> FreeWay:
    """The free way of the first planner that finds one, with a note on each that was asked. `own`: ours.

    Raises Refused: with the problem of ours, or without that if the program does not name it."""
    notes: list[str] = []
    problem: Refused | None = None
    for name in request.algorithms.planners:
        if name != OWN:
            corners, why = _corners(name, request, goal)
            way = rounded(request, corners) if corners else None
            notes.append(f"planner {name}: {why or ('tested: free' if way is not None else 'tested: not free')}")
            if way is not None:
                return FreeWay(way, notes)
            continue
        try:
            found = own()
            return FreeWay(found.path, [*notes, *found.notes])
        except Refused as refused:
            notes.append(f"planner {OWN}: {refused}")
            problem = refused
    clears = by_person(f"a program whose `planners` name {OWN} too")
    raise problem or Refused.because(RefusalReason.INFEASIBLE, "; ".join(notes), clears=clears)


def _corners(name: str, request: PlanningRequest, goal: Array) -> tuple[list[Array], str]:
    """The way-points of one planner, or why they are none."""
    try:
        with registry.guarded(registry.PLANNERS, name):
            found = registry.installed(registry.PLANNERS)[name](_copied(request), goal.copy())
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
