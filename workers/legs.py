"""One leg of a script: from where the arm is to a target, in joint space or straight in task space. Pure.

The words of Figure 4's fourth column are the keys of `SPACES`. The elaborator asks `tested` (is there a way, and where
does it end), the binder asks `timed` (that way, in time).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rtc.geometry import Array
from rtc.outcomes import Refusal, RefusalReason
from workers.motion import ik
from workers.motion import path as paths
from workers.motion.plan import Motion, Setting, fault, free_posture, plan_joint_motion, plan_task_motion

SAME_RAD = 0.02  # a straight line that was to end in given joint values ends no farther from them


@dataclass(frozen=True)
class Target:
    """Exactly one is set: joint values (rad), or a pose of the tcp (world frame)."""

    joints: list[float] | None = None
    pose: list[float] | None = None


def tested(at: Setting, space: str, target: Target, detours: bool) -> Array | Refusal:
    """The joints at the end of the leg, if it can be gone."""
    return _TESTS[space](at, target, detours)


def timed(at: Setting, space: str, target: Target) -> Motion | Refusal:
    """The leg as a motion."""
    return SPACES[space](at, target)


# --- joint space -----------------------------------------------------------------------------------------


def _goal(at: Setting, target: Target) -> Array | Refusal:
    if target.joints is not None:
        return np.asarray(target.joints, dtype=float)
    assert target.pose is not None
    return ik.choose(at.arm, target.pose, at.start, test=free_posture(at), margin_rad=at.margin_rad)


def _timed_joint(at: Setting, target: Target) -> Motion | Refusal:
    goal = _goal(at, target)
    return goal if isinstance(goal, Refusal) else plan_joint_motion(at, goal)


def _tested_joint(at: Setting, target: Target, detours: bool) -> Array | Refusal:
    goal = _goal(at, target)
    if isinstance(goal, Refusal):
        return goal
    problem = at.arm.why_not_within(goal, at.margin_rad)
    problem = problem or (None if _is_there(at, goal) else fault(at, paths.joint_line(at.start, goal)))
    if problem is None:
        return goal
    if not detours:
        return problem
    motion = plan_joint_motion(at, goal)
    return motion if isinstance(motion, Refusal) else motion.goal_joints


def _is_there(at: Setting, goal: Array) -> bool:
    return bool(np.abs(goal - at.start).max() < 1e-9)


# --- task space ------------------------------------------------------------------------------------------


def _pose(at: Setting, target: Target) -> list[float]:
    if target.pose is not None:
        return target.pose
    assert target.joints is not None
    pose: list[float] = at.arm.fk(target.joints).tolist()
    return pose


def _timed_task(at: Setting, target: Target) -> Motion | Refusal:
    motion = plan_task_motion(at, _pose(at, target))
    return motion if isinstance(motion, Refusal) else _other_end(at, target, motion.goal_joints) or motion


def _tested_task(at: Setting, target: Target, detours: bool) -> Array | Refusal:
    line = paths.task_line(at.arm, at.start, _pose(at, target), at.margin_rad)
    if isinstance(line, Refusal):
        return line
    end = line.knots[-1]
    return fault(at, line) or _other_end(at, target, end) or end


def _other_end(at: Setting, target: Target, end: Array) -> Refusal | None:
    """A straight line to given joint values ends in another posture of the same pose."""
    if target.joints is None:
        return None
    off_rad = float(np.abs(end - np.asarray(target.joints)).max())
    if off_rad <= SAME_RAD:
        return None
    return Refusal(
        reason=RefusalReason.INFEASIBLE,
        message=f"a straight line of {at.arm.name} ends in other joint values than those given, for the same place",
        clears="JOINT-MOTION, or a place instead of joint values",
        detail={"cause": "branch", "arm": at.arm.name, "off_rad": off_rad},
    )


#: the fourth column of a script -> how its legs are planned
SPACES: dict[str, Callable[[Setting, Target], Motion | Refusal]] = {
    "move_joint": _timed_joint,
    "move_task": _timed_task,
}
_TESTS: dict[str, Callable[[Setting, Target, bool], Array | Refusal]] = {
    "move_joint": _tested_joint,
    "move_task": _tested_task,
}
