"""A planning problem without its goal, and the tests of a posture and of a path in it. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import msgspec
import numpy as np

from rtc.model.robot.collision import CollisionWorld, PathCollision
from rtc.model.robot.collision_scene import AS_BUILT, Scene
from rtc.model.robot.kinematics import ArmModel
from rtc.model.robot.scene_state import Collision
from rtc.programs.schema import OWN_ALONE, Algorithms
from rtc.protocol.outcomes import Refusal
from rtc.protocol.primitive import Load
from rtc.spatial.geometry import Array, Floats
from workers.planning.motion.constraints import FREE, PathConstraints
from workers.planning.motion.path import CHECK_RAD, Path
from workers.planning.motion.timing import NO_SPEED_LIMITS, SpeedLimits

FINER, FINEST_RAD = 4, CHECK_RAD / 100  # steps of a path whose chords are too near, but perhaps not the path


class PlanningRequest(msgspec.Struct, frozen=True, eq=False):
    """A planning problem without its goal: arm, collision world, start joints, scene, constraints and pace."""

    arm: ArmModel
    world: CollisionWorld
    joints: Mapping[str, Floats]  # current values (rad) of every arm; the planned arm starts there
    scene: Scene = AS_BUILT
    path_constraints: PathConstraints = FREE
    pace: SpeedLimits = NO_SPEED_LIMITS
    margin_rad: float = 0.0  # minimum distance from every joint limit
    load: Load | None = None  # in the hand
    seed: int = 0  # of the sampling planner: the same request has the same path
    algorithms: Algorithms = OWN_ALONE  # who plans
    partner: ArmModel | None = None  # a second arm that holds the same object and moves with it

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


def free_posture(request: PlanningRequest) -> Callable[[Array], Refusal | None]:
    """A test for `ik.choose`: the posture is collision-free and satisfies the constraints; other arms stand still."""

    def test(joints: Array) -> Refusal | None:
        hit = request.world.check({**request.joints, request.arm.name: joints}, request.scene)
        return blocked(request, hit) if hit is not None else request.path_constraints.violation(request.arm, joints)

    return test


def blocked(request: PlanningRequest, hit: Collision) -> Refusal:
    """The refusal for a collision. It names another arm that is in the way, because that arm may leave."""
    refusal, held = hit.refusal(), request.scene.held
    for body in (hit.body_a, hit.body_b):
        owner = body.split()[0]
        arm = held[owner].arm if owner in held else owner
        if arm in request.joints and arm != request.arm.name:
            return msgspec.structs.replace(refusal, in_the_way=arm)
    return refusal


def fault(
    request: PlanningRequest, way: Path, step_rad: float = CHECK_RAD, *, least_room: bool = False
) -> Refusal | None:
    """The first problem along a path, with its position; None if the path is free. `step_rad`: as of `Path.dense`.

    `least_room`: of two bodies that come too near, state where they are nearest.
    """
    return _fault_of(request, way, step_rad, way.dense(step_rad, request.arm.step_weights), least_room=least_room)


def obstacle(request: PlanningRequest, way: Path) -> Refusal | None:
    """Like `fault`, but found sooner: a problem along a path, not always the first; None if the path is free."""
    s, configurations = dense = way.dense(CHECK_RAD, request.arm.step_weights)
    hit = request.world.probe(request.arm.name, configurations, request.joints, request.scene)
    if hit is not None:
        return _at(blocked(request, hit.collision), float(s[hit.index]) / way.length)
    return _fault_of(request, way, CHECK_RAD, dense)


def is_free(request: PlanningRequest, way: Path) -> bool:
    """Whether a path has no `fault`."""
    return obstacle(request, way) is None


def is_soon_free(request: PlanningRequest, way: Path) -> bool:
    """Whether a path is free, and boxes alone prove it: then its ends are free too."""
    s, configurations = dense = way.dense(CHECK_RAD, request.arm.step_weights)
    arm, joints, scene = request.arm.name, request.joints, request.scene
    proven = request.world.proves(arm, configurations, joints, scene, way.off_chords(s))
    return proven and _fault_of(request, way, CHECK_RAD, dense, proven=True) is None


def _fault_of(
    request: PlanningRequest,
    way: Path,
    step_rad: float,
    dense: tuple[Array, Array],
    *,
    least_room: bool = False,
    proven: bool = False,
) -> Refusal | None:
    """`fault` of a path that is given in steps of collision checks: (s, joints). `proven`: it collides nowhere."""
    s, configurations = dense
    hit = None if proven else _first_hit(request, way, step_rad, s, configurations)
    free = configurations if hit is None else configurations[: hit.index]
    room = request.arm.limit_margin_rad(free) if len(free) else math.inf  # one vectorized check; usually enough
    within = room >= request.margin_rad - 1e-9 or room >= request.way_margin_rad - 1e-9
    for n, joints in enumerate(free) if request.path_constraints.any or not within else ():
        problem = None if within else request.arm.why_not_within(joints, request.way_margin_rad - 1e-9)
        problem = problem or request.path_constraints.violation(request.arm, joints)
        if problem is not None:
            return _at(problem, float(s[n]) / way.length)
    if hit is not None and least_room and hit.collision.distance_m > 0.0:
        hit = request.world.least_room(request.arm.name, configurations, request.joints, request.scene, hit)
    return None if hit is None else _at(blocked(request, hit.collision), float(s[hit.index]) / way.length)


def _first_hit(
    request: PlanningRequest, way: Path, step_rad: float, s: Array, configurations: Array
) -> PathCollision | None:
    """The first of these configurations before which, or at which, the path is in collision.

    A chord between two configurations may be too near where the path is not: there it is checked in finer steps. A path
    that leaves a contact is checked so from its start, because the contact is followed from there."""
    world, first = request.world, 0
    arm, joints, scene, off = request.arm.name, request.joints, request.scene, way.off_chords(s)
    while (hit := world.check_path(arm, configurations[first:], joints, scene, off[first:])) is not None:
        n = first + max(1, hit.index)  # a chord may be too near from its begin
        if hit.collision.distance_m <= hit.collision.margin_m or step_rad <= FINEST_RAD:
            return PathCollision(n, hit.collision)
        leaves = first == 0 and world.check({**joints, arm: configurations[0]}, scene) is not None
        begin, end = (0, len(s) - 1) if leaves else (n - 1, n)
        finer = np.interp(np.arange(FINER * begin, FINER * end + 1) / FINER, np.arange(len(s)), s)
        found = _first_hit(request, way, step_rad / FINER, finer, way.joints_at(finer))
        if found is not None:
            return PathCollision(begin + math.ceil(found.index / FINER), found.collision)
        if leaves:
            return None
        first = n
    return None


def _at(problem: Refusal, fraction: float) -> Refusal:
    where = "at the start" if fraction <= 0 else "at the goal" if fraction >= 1 else f"{fraction:.0%} along the way"
    message = f"{problem.message} ({where})"
    return msgspec.structs.replace(problem, message=message, where=where, fraction=fraction)
