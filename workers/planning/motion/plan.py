"""Motion planning: a timed, collision-free path that satisfies the constraints, or a refusal with the cause. Pure.

`plan_task_motion` plans a straight line or refuses. `plan_joint_motion` may choose its path by the paper's "generate,
test and modify" (R92): the direct line first, then detours with the hand raised, drawn back, or both, in the order of
`_modified`. The first that passes is taken; `notes` record the attempts. Deterministic.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import msgspec
import numpy as np

from rtc.protocol.outcomes import Refusal
from rtc.robot import geometry
from rtc.robot.collision import AS_BUILT, CollisionWorld, Scene
from rtc.robot.geometry import Array, Floats
from rtc.robot.kinematics import ArmModel
from workers.planning.motion import path as paths
from workers.planning.motion.constraints import FREE, Rules
from workers.planning.motion.path import Path
from workers.planning.motion.timing import FREE_PACE, Pace, Timed, time_path

# Clearance of a freely chosen path from all bodies that it need not approach. The hand tracks a path to tenths of a
# millimetre, and the pose of a held object is known to a few millimetres: a path without clearance may collide.
CLEARANCE_M = 0.005
NEAR_AT_MOST = 12  # maximum number of bodies closer than the clearance at either end of a path
RAISE_M = (0.15, 0.30)  # heights by which a detour raises the hand
BACK_M = (0.10, 0.20)  # distances by which a detour draws the hand back along its own axis
DIRECT = "generated a line in joint space; tested: free"


@dataclass(frozen=True, eq=False)
class PlanningRequest:
    """A planning problem without its goal: arm, collision world, start joints, scene, constraints and pace."""

    arm: ArmModel
    world: CollisionWorld
    joints: Mapping[str, Floats]  # current values (rad) of every arm; the planned arm starts there
    scene: Scene = AS_BUILT
    rules: Rules = FREE
    pace: Pace = FREE_PACE
    margin_rad: float = 0.0  # minimum distance from every joint limit

    @property
    def start(self) -> Array:
        return np.asarray(self.joints[self.arm.name], dtype=float)

    @property
    def way_margin_rad(self) -> float:
        """Margin along the path (rad): reduced if the arm starts closer to a limit than `margin_rad`."""
        return max(0.0, min(self.margin_rad, self.arm.limit_margin_rad(self.start)))


class FreeWay(NamedTuple):
    """A way that is free, without its timing. `notes`: what was generated, tested and modified until it was found."""

    path: Path
    notes: list[str]


@dataclass(frozen=True, eq=False)
class Motion:
    path: Path
    timed: Timed
    goal_joints: Array
    goal_pose: Array
    notes: list[str] = field(default_factory=list)


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
    roomy = replace(request, scene=_with_room(request, goal))
    found = _generate_and_test(roomy, goal)
    if isinstance(found, Refusal) and roomy.scene is not request.scene:
        found = _generate_and_test(request, goal)
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
    if occupied is None and fault(replace(request, scene=_with_room(request, goal)), line) is None:
        return FreeWay(line, [DIRECT])
    return fault(request, line) or occupied


def _generate_and_test(request: PlanningRequest, goal: Array) -> FreeWay | Refusal:
    direct = paths.joint_line(request.start, goal)
    first = fault(request, direct)
    if first is None:
        return FreeWay(direct, [DIRECT])
    notes = [f"generated a line in joint space; tested: {first.message}"]
    for words, candidate in _modified(request, goal):
        problem = fault(request, candidate)
        notes.append(f"modified: {words}; tested: {problem.message if problem else 'free'}")
        if problem is None:
            return FreeWay(candidate, notes)
    return msgspec.structs.replace(first, detail={**first.detail, "ways_tried": float(len(notes))})


def _with_room(request: PlanningRequest, goal: Array) -> Scene:
    """The scene with `CLEARANCE_M`, except for bodies that are closer at either end of the path.

    Returns the scene unchanged if the command states a clearance, or if more than NEAR_AT_MOST bodies are close.
    """
    if request.scene.clearance_m > 0.0:
        return request.scene
    ours = {request.arm.name, *(name for name, held in request.scene.held.items() if held.arm == request.arm.name)}
    near = list(request.scene.near)
    scene = replace(request.scene, clearance_m=CLEARANCE_M, near=near)
    start = request.start
    for end in (start, goal):
        while hit := request.world.check({**request.joints, request.arm.name: end}, scene):
            name = hit.body_a if hit.body_b.split()[0] in ours else hit.body_b
            if name in near and end is start:
                break  # in contact, not only close: `check_path` decides how to leave it
            if len(near) >= len(list(request.scene.near)) + NEAR_AT_MOST:
                return request.scene
            near.append(name)
            scene = replace(scene, near=list(near))
    return scene


def free_posture(request: PlanningRequest) -> Callable[[Array], Refusal | None]:
    """A test for `ik.choose`: the posture is collision-free and satisfies the constraints; other arms stand still."""

    def test(joints: Array) -> Refusal | None:
        hit = request.world.check({**request.joints, request.arm.name: joints}, request.scene)
        return hit.refusal() if hit is not None else request.rules.broken_by(request.arm, joints)

    return test


def fault(request: PlanningRequest, way: Path) -> Refusal | None:
    """The first problem along a path, with its position; None if the path is free."""
    s, configurations = way.dense()
    hit = request.world.check_path(request.arm.name, configurations, request.joints, request.scene)
    free = configurations if hit is None else configurations[: hit.index]
    margin = request.way_margin_rad - 1e-9
    within = len(free) == 0 or request.arm.limit_margin_rad(free) >= margin  # one vectorized check; usually true
    for n, joints in enumerate(free):
        problem = (None if within else request.arm.why_not_within(joints, margin)) or request.rules.broken_by(
            request.arm, joints
        )
        if problem is not None:
            return _at(problem, float(s[n]) / way.length)
    return None if hit is None else _at(hit.collision.refusal(), float(s[hit.index]) / way.length)


def _modified(request: PlanningRequest, goal: Array) -> Iterator[tuple[str, Path]]:
    """Alternative paths: a straight tcp line, then detours over way-points above or behind both ends."""
    start_pose, goal_pose = request.arm.fk(request.start), request.arm.fk(goal)
    straight = paths.task_line(request.arm, request.start, goal_pose, request.way_margin_rad)
    if not isinstance(straight, Refusal) and np.abs(straight.knots[-1] - goal).max() < 1e-6:
        yield "a straight line of the hand", straight
    for back in (0.0, *BACK_M):
        for up in (0.0, *RAISE_M):
            if back == up == 0.0:
                continue
            words = " and ".join([f"raised by {up:.2f} m"] * (up > 0) + [f"drawn back by {back:.2f} m"] * (back > 0))
            moved = [
                geometry.translate(geometry.compose(p, (0, 0, -back, 0, 0, 0, 1)), (0, 0, up))
                for p in (start_pose, goal_pose)
            ]
            corners = [request.arm.follow(moved[0], request.start), request.arm.follow(moved[1], goal)]
            if any(c is None or request.arm.why_not_within(c, request.margin_rad) is not None for c in corners):
                continue
            first, second = (np.asarray(c) for c in corners)
            yield f"by way of both ends {words}", paths.through([request.start, first, second, goal])
            yield f"by way of the start {words}", paths.through([request.start, first, goal])
            yield f"by way of the goal {words}", paths.through([request.start, second, goal])


def in_time(request: PlanningRequest, found: FreeWay) -> Motion:
    """The way as a motion, timed at the pace of the request."""
    goal = found.path.knots[-1]
    return Motion(found.path, time_path(request.arm, found.path, request.pace), goal, request.arm.fk(goal), found.notes)


def _at(problem: Refusal, fraction: float) -> Refusal:
    where = "at the start" if fraction <= 0 else "at the goal" if fraction >= 1 else f"{fraction:.0%} along the way"
    message = f"{problem.message} ({where})"
    return msgspec.structs.replace(
        problem, message=message, where=where, detail={**problem.detail, "fraction": fraction}
    )
