"""Path segments of a script: from the arm's position to a target, in joint space, straight or along a curve. Pure.

The keys of `SPACES` are the words of the fourth column of the paper's Figure 4. The elaborator calls `check_segment`
(is there a path, and where does it end); the binder calls `plan_segment` (the timed motion).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from rtc.programs.schema import OWN
from rtc.programs.step_kinds import CURVES
from rtc.protocol.advice import by_person
from rtc.protocol.causes import OtherBranch
from rtc.protocol.messages import PlannedPath
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused, refuse_if
from rtc.spatial.geometry import Array, Floats
from workers.planning.motion import ik, path_reuse
from workers.planning.motion.carry import plan_carry
from workers.planning.motion.ik import Posture
from workers.planning.motion.path import poses_through
from workers.planning.motion.plan import (
    Motion,
    find_curve,
    find_direct_way,
    find_joint_way,
    find_spline,
    find_task_way,
    in_time,
    plan_joint_motion,
    plan_task_motion,
)
from workers.planning.motion.request import FreeWay, PlanningRequest, free_posture

SAME_RAD = 0.02  # tolerance of the joint values at the end of a straight line


class Target(msgspec.Struct, frozen=True, eq=False):
    """Exactly one of the first three is set: joint values (rad), a pose of the tcp (world frame), or the poses of a
    curve, [poses][7]."""

    joints: list[float] | None = None
    pose: list[float] | None = None
    poses: Array | None = None
    via: tuple[Target, ...] = ()  # to be passed on the way, in this order
    around: bool = False  # two arms may leave the straight line where that is not free


class FreeSegment(NamedTuple):
    """A segment that is free. `found`: the way that `plan_segment` would take to `goal`; None: not known."""

    end: Array  # rad, joint values at the end
    goal: Floats  # joint values (rad), or pose of the tcp in world axes
    found: FreeWay | None = None

    def way(self, request: PlanningRequest, space: str) -> PlannedPath | None:
        """The way as it is sent to the binder; None: not known."""
        if self.found is None:
            return None
        return path_reuse.to_message(path_reuse.request_digest(request, space, self.goal), self.found)


def check_segment(request: PlanningRequest, space: str, target: Target, detours: bool, first: bool) -> FreeSegment:
    """The segment with the joint values (rad) at its end. Raises Refused if it is blocked.

    `detours`: also try paths with way-points if the direct path is blocked.
    `first`: the segment starts where the arm is now; find the way that `plan_segment` would take.
    """
    return _TESTS[space](request, target, detours, first)


def plan_segment(request: PlanningRequest, space: str, target: Target, known: PlannedPath | None = None) -> Motion:
    """The segment as a timed motion. `known`: a way found before; of another request it is tested again.

    Raises Refused."""
    return SPACES[space](request, target, known)


# --- joint space -----------------------------------------------------------------------------------------


def _goal(request: PlanningRequest, target: Target) -> Posture:
    if target.joints is not None:
        return Posture(np.asarray(target.joints, dtype=float))
    assert target.pose is not None
    test, solvers = free_posture(request), request.algorithms.ik
    return ik.choose(request.arm, target.pose, request.start, test=test, margin_rad=request.margin_rad, solvers=solvers)


def _timed_joint(request: PlanningRequest, target: Target, known: PlannedPath | None) -> Motion:
    goal, notes = _goal(request, target)
    motion = _timed_joint_to(request, target, goal, known)
    return replace(motion, notes=[*notes, *motion.notes]) if notes else motion


def _timed_joint_to(request: PlanningRequest, target: Target, goal: Array, known: PlannedPath | None) -> Motion:
    if target.via:
        return in_time(request, _through(request, target, goal))
    if known is None:
        return plan_joint_motion(request, goal)
    before = path_reuse.from_message(known)
    if known.request_digest == path_reuse.request_digest(request, "move_joint", goal):
        return in_time(request, before)
    return plan_joint_motion(request, goal, before.path)


def _tested_joint(request: PlanningRequest, target: Target, detours: bool, first: bool) -> FreeSegment:
    goal, found = _goal(request, target).joints, None
    if target.via:
        _through(request, target, goal)
    elif _is_there(request, goal):
        refuse_if(request.arm.why_not_within(goal, request.margin_rad))
    else:
        ours_first = request.algorithms.planners[0] == OWN
        direct = ours_first and not detours
        found = find_direct_way(request, goal, with_room=first) if direct else find_joint_way(request, goal)
    return FreeSegment(goal, goal, found)


def _through(request: PlanningRequest, target: Target, goal: Array) -> FreeWay:
    """The spline through the via points; each with the joint values nearest to those before it."""
    postures = [request.start]
    for n, via in enumerate(target.via, 1):
        now = replace(request, joints={**request.joints, request.arm.name: postures[-1]})
        try:
            postures.append(_goal(now, via).joints)
        except Refused as refused:
            message = f"{refused} (via point {n})"
            raise Refused(msgspec.structs.replace(refused.refusal, message=message, where=f"via point {n}")) from None
    return find_spline(request, [*postures, goal])


def _is_there(request: PlanningRequest, goal: Array) -> bool:
    return bool(np.abs(goal - request.start).max() < 1e-9)


# --- task space ------------------------------------------------------------------------------------------


def _pose(request: PlanningRequest, target: Target) -> list[float]:
    if target.pose is not None:
        return target.pose
    assert target.joints is not None
    pose: list[float] = request.arm.fk(target.joints).tolist()
    return pose


def _timed_task(request: PlanningRequest, target: Target, known: PlannedPath | None) -> Motion:
    pose = _pose(request, target)
    if target.via:
        motion = _timed_curve(request, _smooth(request, target, pose), known)
    elif known is not None and known.request_digest == path_reuse.request_digest(request, "move_task", pose):
        motion = in_time(request, path_reuse.from_message(known))
    else:
        motion = plan_task_motion(request, pose)
    refuse_if(_other_end(request, target, motion.goal_joints))
    return motion


def _tested_task(request: PlanningRequest, target: Target, detours: bool, first: bool) -> FreeSegment:
    pose = _pose(request, target)
    if target.via:
        segment = _tested_curve(request, _smooth(request, target, pose), detours, first)
    else:
        found = find_task_way(request, pose, request.margin_rad)
        segment = FreeSegment(found.path.knots[-1], pose, found)
    refuse_if(_other_end(request, target, segment.end))
    return segment


def _smooth(request: PlanningRequest, target: Target, goal: list[float]) -> Target:
    """The curve of the hand through the via points."""
    vias = [_pose(request, via) for via in target.via]
    return Target(poses=poses_through([request.arm.fk(request.start), *vias, goal]))


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
        clears=by_person("JOINT-MOTION, or a place instead of joint values"),
        cause=OtherBranch(arm=request.arm.name, off_rad=off_rad),
    )


# --- curves ----------------------------------------------------------------------------------------------


def _timed_curve(request: PlanningRequest, target: Target, known: PlannedPath | None) -> Motion:
    assert target.poses is not None
    return in_time(request, find_curve(request, target.poses, request.way_margin_rad))


def _tested_curve(request: PlanningRequest, target: Target, detours: bool, first: bool) -> FreeSegment:
    assert target.poses is not None
    return FreeSegment(find_curve(request, target.poses, request.margin_rad).path.knots[-1], target.poses[-1])


# --- two arms --------------------------------------------------------------------------------------------


def _timed_both(request: PlanningRequest, target: Target, known: PlannedPath | None) -> Motion:
    if request.partner is None:
        message = f"{request.arm.name} has no partner: no other arm holds the same object"
        raise Refused.because(RefusalReason.STATE, message, clears="a command for one arm")
    motion = plan_carry(request, _pose(request, target), around=target.around)
    refuse_if(_other_end(request, target, motion.goal_joints))
    return motion


def _tested_both(request: PlanningRequest, target: Target, detours: bool, first: bool) -> FreeSegment:
    motion = _timed_both(request, target, None)
    return FreeSegment(motion.goal_joints, motion.goal_pose)


#: fourth column of a script -> planner of its segments
SPACES: dict[str, Callable[[PlanningRequest, Target, PlannedPath | None], Motion]] = {
    "move_joint": _timed_joint,
    "move_task": _timed_task,
    **dict.fromkeys(CURVES, _timed_curve),
    "move_both": _timed_both,
}
BOTH = "move_both"  # space of the steps that move two arms
STRAIGHT = frozenset(("move_task", *CURVES))  # lines and curves of one hand
_TESTS: dict[str, Callable[[PlanningRequest, Target, bool, bool], FreeSegment]] = {
    "move_joint": _tested_joint,
    "move_task": _tested_task,
    **dict.fromkeys(CURVES, _tested_curve),
    "move_both": _tested_both,
}
