"""Motion planning: a timed, collision-free path that satisfies the constraints, or a refusal with the cause. Pure.

`plan_task_motion` plans a straight line or refuses. `plan_joint_motion` may choose its path by the paper's "generate,
test and modify" (R92). It tries a line in joint space, then a straight line of the hand, then a way found by sampling.
The first that passes is taken; `notes` record the attempts. Deterministic: the seed is part of the request.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import msgspec
import numpy as np

from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.robot.collision_scene import Scene
from rtc.robot.geometry import Array, Floats
from workers.planning.motion import path as paths
from workers.planning.motion.path import Path
from workers.planning.motion.request import FreeWay, PlanningRequest, fault, free_posture
from workers.planning.motion.sampled_way import find_sampled_way
from workers.planning.motion.timing import Timed, slower, time_path

# Clearance of a freely chosen path from all bodies that it need not approach. The hand tracks a path to tenths of a
# millimetre, and the pose of a held object is known to a few millimetres: a path without clearance may collide.
CLEARANCE_M = 0.005
NEAR_AT_MOST = 12  # maximum number of bodies closer than the clearance at either end of a path
NOTHING: Mapping[str, float] = MappingProxyType({})
SAME_RAD = 1e-6  # tolerance of the joint values at the end of a straight line
DIRECT = "generated a line in joint space; tested: free"


@dataclass(frozen=True, eq=False)
class Motion:
    path: Path
    timed: Timed
    goal_joints: Array
    goal_pose: Array
    notes: list[str] = field(default_factory=list)
    partner: Timed | None = None  # the motion of the second arm, if the request has one


def plan_task_motion(request: PlanningRequest, goal_pose: Floats) -> Motion | Refusal:
    """Plan a straight tcp line to `goal_pose` (world)."""
    found = find_task_way(request, goal_pose, request.way_margin_rad)
    return found if isinstance(found, Refusal) else in_time(request, found)


def find_task_way(request: PlanningRequest, goal_pose: Floats, margin_rad: float) -> FreeWay | Refusal:
    """A straight tcp line that keeps `margin_rad` from every joint limit, without its timing."""
    line = paths.task_line(request.arm, request.start, goal_pose, margin_rad)
    if isinstance(line, Refusal):
        return line
    return fault(request, line) or FreeWay(line, ["generated a straight line of the hand; tested: free"])


def find_curve(request: PlanningRequest, poses: Array, margin_rad: float) -> FreeWay | Refusal:
    """The tcp through these poses (world, [poses][7]) from the start, with `margin_rad` from every joint limit."""
    line = paths.task_curve(request.arm, request.start, poses, margin_rad)
    if isinstance(line, Refusal):
        return line
    return fault(request, line) or FreeWay(line, ["generated a curve of the hand; tested: free"])


def find_spline(request: PlanningRequest, postures: Sequence[Floats]) -> FreeWay | Refusal:
    """A smooth curve in joint space through these postures (rad), the first of which is the start."""
    for posture in postures[1:]:
        if (problem := request.arm.why_not_within(posture, request.way_margin_rad)) is not None:
            return problem
    way = paths.spline_through(postures)
    return fault(request, way) or FreeWay(way, ["generated a spline through the places; tested: free"])


def plan_joint_motion(request: PlanningRequest, goal: Floats) -> Motion | Refusal:
    """Plan a motion to the joint values `goal` (rad) on any path, with `CLEARANCE_M` if such a path exists."""
    found = find_joint_way(request, goal)
    return found if isinstance(found, Refusal) else in_time(request, found)


def find_joint_way(request: PlanningRequest, goal: Floats) -> FreeWay | Refusal:
    """The path of `plan_joint_motion`, without its timing."""
    goal = np.asarray(goal, dtype=float)
    problem = request.arm.why_not_within(goal, request.margin_rad) or free_posture(request)(goal)
    if problem is not None:
        return problem
    around = _around_hand(request, goal)
    roomy = replace(request, scene=roomy_scene(request, goal, around))
    found = _generate_and_test(roomy, goal, sample=not around)
    if isinstance(found, Refusal) and roomy.scene is not request.scene:
        found = _generate_and_test(_leaving(request, around), goal, sample=not around)
    return found


def find_direct_way(request: PlanningRequest, goal: Floats, with_room: bool) -> FreeWay | Refusal | None:
    """Test the line in joint space to `goal`. A Refusal: the line is not free.

    `with_room`: test also with `CLEARANCE_M` to spare, and return the line if `plan_joint_motion` would take it.
    None: the line is free, but `plan_joint_motion` would try other ways first, or that was not tested.
    """
    goal = np.asarray(goal, dtype=float)
    problem = request.arm.why_not_within(goal, request.margin_rad)
    if problem is not None:
        return problem
    line = paths.joint_line(request.start, goal)
    if not with_room:
        return fault(request, line)
    occupied = free_posture(request)(goal)
    around = _around_hand(request, goal)
    if occupied is None and fault(replace(request, scene=roomy_scene(request, goal, around)), line) is None:
        return FreeWay(line, [DIRECT])
    return occupied or fault(_leaving(request, around), line)  # a goal that is taken tells more than the line to it


def _around_hand(request: PlanningRequest, goal: Array) -> dict[str, float]:
    """The bodies that the hand may touch where it is, because their place is not known well, with that uncertainty (m).

    The hand is at a handle, for example. Bodies that it may touch at the goal too are left out: it stays there."""
    scene = request.scene
    if not scene.unsure_m:
        return {}
    unsure = replace(scene, keeps_unsure=True, clearance_m=0.0)
    here, there = (_within_hand(request, joints, unsure) for joints in (request.start, goal))
    return {name: scene.unsure_m[name] for name in sorted(here - there)}


def _within_hand(request: PlanningRequest, joints: Array, scene: Scene) -> set[str]:
    """The uncertain bodies that links of the hand may touch at these joint values (rad)."""
    arm = request.arm.name
    gripper = request.world.cell.arm(arm).gripper
    links = {f"{arm} {link}" for link in (gripper.palm_link, *gripper.finger_links)}
    near = request.world.near(arm, {**request.joints, arm: joints}, scene)
    return {hit.body_b.split()[0] for hit in near if hit.body_a in links} & scene.unsure_m.keys()


def _leaving(request: PlanningRequest, around: dict[str, float]) -> PlanningRequest:
    """The request for a motion that may only move away from these bodies, until it is farther than their uncertainty.

    `CollisionWorld.check_path` has the rule for pairs that are too near at the start."""
    if not around:
        return request
    return replace(request, scene=replace(request.scene, unsure_m=around, keeps_unsure=True))


def _generate_and_test(request: PlanningRequest, goal: Array, sample: bool = True) -> FreeWay | Refusal:
    direct = paths.joint_line(request.start, goal)
    first = fault(request, direct)
    if first is None:
        return FreeWay(direct, [DIRECT])
    notes = [f"generated a line in joint space; tested: {first.message}"]
    straight = _straight(request, goal)
    problem = straight if isinstance(straight, Refusal) else fault(request, straight)
    notes.append(f"modified: a straight line of the hand; tested: {problem.message if problem else 'free'}")
    if isinstance(straight, Path) and problem is None:
        return FreeWay(straight, notes)
    if not sample:
        return first
    sampled = find_sampled_way(request, [goal])
    if isinstance(sampled, FreeWay):
        return FreeWay(sampled.path, [*notes, *sampled.notes])
    return msgspec.structs.replace(
        first,
        message=f"{first.message}; no way round it was found in {sampled} samples",
        detail={**first.detail, "samples": float(sampled)},
    )


def _straight(request: PlanningRequest, goal: Array) -> Path | Refusal:
    """The straight line of the hand to the pose of `goal`, if it ends with these joint values."""
    line = paths.task_line(request.arm, request.start, request.arm.fk(goal), request.way_margin_rad)
    if isinstance(line, Refusal) or np.abs(line.knots[-1] - goal).max() < SAME_RAD:
        return line
    return Refusal(reason=RefusalReason.INFEASIBLE, message=f"{request.arm.name} would end with other joint values")


def roomy_scene(request: PlanningRequest, goal: Array, around: Mapping[str, float] = NOTHING) -> Scene:
    """The scene with `CLEARANCE_M`, except for bodies that are closer at either end of the path. A body whose place is
    not known well needs that much more; also at the start if it is `around` the hand.

    Returns the scene unchanged (but for `around`) if the command states a clearance, or if more than NEAR_AT_MOST
    bodies are close.
    """
    unchanged = _leaving(request, dict(around)).scene
    if request.scene.clearance_m > 0.0:
        return unchanged
    carried = {name for name, held in request.scene.held.items() if held.arm == request.arm.name}
    ours = {request.arm.name, *carried}
    # A seat need not be approached before the motion into it begins. The walls that are close at either end follow.
    seats = {seat.name for seat in request.world.cell.seats} if carried else set()
    near = [name for name in request.scene.near if name not in seats]
    allowed = len(near) + NEAR_AT_MOST
    scene = replace(request.scene, clearance_m=CLEARANCE_M, near=near, keeps_unsure=True)
    start = request.start
    for end in (start, goal):
        while hit := request.world.check({**request.joints, request.arm.name: end}, scene):
            name = hit.body_a if hit.body_b.split()[0] in ours else hit.body_b
            if name.split()[0] in scene.unsure_m:
                others = {body: most_m for body, most_m in scene.unsure_m.items() if body != name.split()[0]}
                scene = replace(scene, unsure_m=others)
                continue
            if name in near and end is start:
                break  # in contact, not only close: `check_path` decides how to leave it
            if len(near) >= allowed:
                return unchanged
            near.append(name)
            scene = replace(scene, near=list(near))
    return replace(scene, unsure_m={**scene.unsure_m, **around}) if around else scene


def lasting(motion: Motion, takes_s: float) -> Motion | Refusal:
    """The motion on the same path, made slower so that it lasts `takes_s`; refused if it cannot be that fast."""
    least_s = motion.timed.duration_s
    if takes_s < least_s:
        return Refusal(
            reason=RefusalReason.INFEASIBLE,
            message=f"this motion shall take {takes_s:.3g} s; the arm needs {least_s:.3g} s for it",
            clears=f"takes_s of at least {least_s:.3g} s, or a higher speed",
            detail={"cause": "time", "limit_s": takes_s, "predicted_s": least_s},
        )
    by = takes_s / least_s
    partner = slower(motion.partner, by) if motion.partner is not None else None
    return replace(motion, timed=slower(motion.timed, by), partner=partner)


def in_time(request: PlanningRequest, found: FreeWay) -> Motion | Refusal:
    """The way as a motion, timed at the pace of the request; or the refusal of a load that is too heavy for it."""
    timed = time_path(request.arm, found.path, request.pace, request.load)
    if isinstance(timed, Refusal):
        return timed
    goal = found.path.knots[-1]
    return Motion(found.path, timed, goal, request.arm.fk(goal), found.notes)
