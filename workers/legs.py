"""Path segments of a script: from the arm's position to a target, in joint space or straight in task space. Pure.

The keys of `SPACES` are the words of the fourth column of the paper's Figure 4. The elaborator calls `check_segment`
(is there a path, and where does it end); the binder calls `plan_segment` (the timed motion).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rtc.geometry import Array
from rtc.outcomes import Refusal, RefusalReason
from workers.motion import ik
from workers.motion import path as paths
from workers.motion.plan import Motion, PlanningRequest, fault, free_posture, plan_joint_motion, plan_task_motion

SAME_RAD = 0.02  # tolerance of the joint values at the end of a straight line


@dataclass(frozen=True)
class Target:
    """Exactly one is set: joint values (rad), or a pose of the tcp (world frame)."""

    joints: list[float] | None = None
    pose: list[float] | None = None


def check_segment(request: PlanningRequest, space: str, target: Target, detours: bool) -> Array | Refusal:
    """The joint values (rad) at the end of the segment, or the refusal if it is blocked.

    `detours`: also try paths with way-points if the direct path is blocked.
    """
    return _TESTS[space](request, target, detours)


def plan_segment(request: PlanningRequest, space: str, target: Target) -> Motion | Refusal:
    """The segment as a timed motion."""
    return SPACES[space](request, target)


# --- joint space -----------------------------------------------------------------------------------------


def _goal(request: PlanningRequest, target: Target) -> Array | Refusal:
    if target.joints is not None:
        return np.asarray(target.joints, dtype=float)
    assert target.pose is not None
    return ik.choose(request.arm, target.pose, request.start, test=free_posture(request), margin_rad=request.margin_rad)


def _timed_joint(request: PlanningRequest, target: Target) -> Motion | Refusal:
    goal = _goal(request, target)
    return goal if isinstance(goal, Refusal) else plan_joint_motion(request, goal)


def _tested_joint(request: PlanningRequest, target: Target, detours: bool) -> Array | Refusal:
    goal = _goal(request, target)
    if isinstance(goal, Refusal):
        return goal
    problem = request.arm.why_not_within(goal, request.margin_rad)
    problem = problem or (None if _is_there(request, goal) else fault(request, paths.joint_line(request.start, goal)))
    if problem is None:
        return goal
    if not detours:
        return problem
    motion = plan_joint_motion(request, goal)
    return motion if isinstance(motion, Refusal) else motion.goal_joints


def _is_there(request: PlanningRequest, goal: Array) -> bool:
    return bool(np.abs(goal - request.start).max() < 1e-9)


# --- task space ------------------------------------------------------------------------------------------


def _pose(request: PlanningRequest, target: Target) -> list[float]:
    if target.pose is not None:
        return target.pose
    assert target.joints is not None
    pose: list[float] = request.arm.fk(target.joints).tolist()
    return pose


def _timed_task(request: PlanningRequest, target: Target) -> Motion | Refusal:
    motion = plan_task_motion(request, _pose(request, target))
    return motion if isinstance(motion, Refusal) else _other_end(request, target, motion.goal_joints) or motion


def _tested_task(request: PlanningRequest, target: Target, detours: bool) -> Array | Refusal:
    line = paths.task_line(request.arm, request.start, _pose(request, target), request.margin_rad)
    if isinstance(line, Refusal):
        return line
    end = line.knots[-1]
    return fault(request, line) or _other_end(request, target, end) or end


def _other_end(request: PlanningRequest, target: Target, end: Array) -> Refusal | None:
    """Refusal if a straight line reaches the pose of the given joint values on another branch; else None."""
    if target.joints is None:
        return None
    off_rad = float(np.abs(end - np.asarray(target.joints)).max())
    if off_rad <= SAME_RAD:
        return None
    return Refusal(
        reason=RefusalReason.INFEASIBLE,
        message=f"a straight line of {request.arm.name} reaches the same pose with other joint values than those given",
        clears="JOINT-MOTION, or a place instead of joint values",
        detail={"cause": "branch", "arm": request.arm.name, "off_rad": off_rad},
    )


#: fourth column of a script -> planner of its segments
SPACES: dict[str, Callable[[PlanningRequest, Target], Motion | Refusal]] = {
    "move_joint": _timed_joint,
    "move_task": _timed_task,
}
_TESTS: dict[str, Callable[[PlanningRequest, Target, bool], Array | Refusal]] = {
    "move_joint": _tested_joint,
    "move_task": _tested_task,
}
