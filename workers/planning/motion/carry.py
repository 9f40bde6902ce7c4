"""Motions of two arms that hold one object: a closed chain. Pure.

The second arm is the partner. Its hand keeps its pose in the axes of the first hand, so both hold the object as they do
now. The first hand moves in a straight line. Where that has too little room, it goes aside by a curve, if it may.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import msgspec
import numpy as np
from msgspec.structs import replace

from rtc.model.robot import quintic
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.causes import Collides, OutOfReach
from rtc.protocol.outcomes import Refusal, Refused, refuse_if
from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats
from workers.planning.motion import timings
from workers.planning.motion.path import Path, poses_through, task_curve, task_line
from workers.planning.motion.plan import Motion
from workers.planning.motion.request import PlanningRequest
from workers.planning.motion.timing import Timed, slower

SLACK_M = 0.0003  # tolerance of the distance of bodies that are near at the start
ASIDE_M = (0.01, 0.03, 0.06, 0.12, 0.2)  # how far a curve goes aside of the line that is not free
FEW = 16  # postures of a curve that are tested before it is timed


def plan_carry(request: PlanningRequest, goal_pose: Floats, *, around: bool = False) -> Motion:
    """The hand to `goal_pose` (world), with the partner of the request, in a straight line. Raises Refused.

    `around`: where bodies are too near to the line, by the curve that goes aside least."""
    arm, partner = request.arm, request.partner
    assert partner is not None
    line = task_line(arm, request.start, goal_pose, request.way_margin_rad)
    words = f", and the way of {partner.name} with it; tested"
    try:
        return _carried(request, partner, line, [f"generated a straight line of the hand{words}: free"])
    except Refused as refused:
        if not around or not isinstance(refused.refusal.cause, Collides | OutOfReach):
            raise
        notes, blocked = [f"generated a straight line of the hand{words}: {refused}"], refused.refusal
    for aside_m, poses in _detours(arm.fk(request.start), np.asarray(goal_pose, dtype=float)):
        found = f"modified: a curve that goes aside by {aside_m:g} m; tested: free"
        try:
            way = task_curve(arm, request.start, poses_through(poses), request.way_margin_rad)
            refuse_if(_soon_fault(request, partner, way))
            return _carried(request, partner, way, [*notes, found])
        except Refused:
            continue
    message = f"{blocked.message}; no way round it was found within {ASIDE_M[-1]:g} m of the line"
    raise Refused(msgspec.structs.replace(blocked, message=message))


def _carried(request: PlanningRequest, partner: ArmModel, way: Path, notes: list[str]) -> Motion:
    """The motion on this way. Raises Refused."""
    arm = request.arm
    timed, words = timings.time_path(request, way)
    leads, follows = carry_along(arm, timed, partner, request.joints[partner.name], request.margin_rad)
    refuse_if(_fault(request, partner, leads.positions, follows.positions))
    goal = way.knots[-1]
    return Motion(way, leads, goal, arm.fk(goal), [*notes, *words], partner=follows)


def _detours(start: Array, goal: Array) -> Iterator[tuple[float, list[Array]]]:
    """Poses of curves aside of the line, nearest first: by its middle moved aside, and by both its ends."""
    along = goal[:3] - start[:3]
    length_m = float(np.linalg.norm(along))
    if length_m < ASIDE_M[0]:
        return
    up = np.array((0.0, 0.0, 1.0)) if abs(along[2]) < 0.9 * length_m else np.array((1.0, 0.0, 0.0))
    side = np.cross(along, up)
    side /= np.linalg.norm(side)
    up = np.cross(side, along) / length_m
    middle = geometry.interpolate_all(start, goal, np.array((0.5,)))[0]
    for aside_m in ASIDE_M:
        for a, b in ((1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 0)):
            by = aside_m * (a * up + b * side) / math.hypot(a, b)
            yield aside_m, [start, _shifted(middle, by), goal]
            yield aside_m, [start, _shifted(start, by), _shifted(goal, by), goal]


def _shifted(pose: Array, by: Array) -> Array:
    return np.concatenate((pose[:3] + by, pose[3:]))


def _soon_fault(request: PlanningRequest, partner: ArmModel, way: Path) -> Refusal | None:
    """As `_fault`, of few postures of a way without its timing. Raises Refused where the partner cannot follow."""
    arm, start = request.arm, np.asarray(request.joints[partner.name], dtype=float)
    leads = way.joints_at(np.linspace(0.0, way.length, FEW))
    hand = geometry.relative(arm.fk(leads[0]), partner.fk(start))
    follows = partner.ik_along(np.array([geometry.compose(arm.fk(q), hand) for q in leads[1:]]), start)
    return _fault(request, partner, leads[: 1 + len(follows)], np.vstack((start, follows)))


def _fault(request: PlanningRequest, partner: ArmModel, leads: Array, follows: Array) -> Refusal | None:
    """The first collision or broken rule in these postures of both arms (rad); None if there is none."""
    scene = request.scene
    hand = request.world.cell.arm(partner.name).gripper
    held = [name for name, by in scene.held.items() if by.arm == request.arm.name]
    touched = [(f"{partner.name} {link}", thing) for link in (hand.palm_link, *hand.finger_links) for thing in held]
    within = replace(request.path_constraints, attitude=None, load=())  # they are of the first hand
    scene = replace(scene, moving="", ignore=[*scene.ignore, *touched])
    # What is nearer than the clearance already comes no nearer.
    near = sorted(request.world.too_near(request.joints, scene), key=lambda hit: -hit.distance_m)
    scene = replace(scene, close={(hit.body_a, hit.body_b): hit.distance_m - SLACK_M for hit in near})
    for n, (q, theirs) in enumerate(zip(leads, follows, strict=True)):
        hit = request.world.check({**request.joints, request.arm.name: q, partner.name: theirs}, scene)
        problem = hit.refusal() if hit is not None else request.path_constraints.violation(request.arm, q)
        problem = problem or within.violation(partner, theirs)
        if problem is not None:
            share = n / max(1, len(leads) - 1)
            return msgspec.structs.replace(
                problem, message=f"{problem.message} ({share:.0%} along the way)", fraction=share
            )
    return None


def carry_along(
    arm: ArmModel, timed: Timed, partner: ArmModel, start: Floats, margin_rad: float
) -> tuple[Timed, Timed]:
    """The motion of `arm`, and that of `partner` from `start` (rad); both are slowed if the partner needs it.

    Raises Refused if the partner cannot follow: reach, joint limits within `margin_rad`, or a leap near a singularity.
    """
    hand = geometry.relative(arm.fk(timed.positions[0]), partner.fk(start))
    poses = [geometry.compose(arm.fk(q), hand) for q in timed.positions]
    positions = _follow(partner, poses, np.asarray(start, dtype=float), margin_rad)
    velocities = np.array(
        [_rates(arm, q, qd, partner, p) for q, qd, p in zip(timed.positions, timed.velocities, positions, strict=True)]
    )
    few = len(timed.time_s) < 3  # it is there already
    accelerations = np.gradient(velocities, timed.time_s, axis=0, edge_order=1 if few else 2)
    velocities[[0, -1]] = accelerations[[0, -1]] = 0.0
    follows = Timed(timed.space, timed.time_s, positions, velocities, accelerations)
    points = quintic.control_points(follows.time_s, positions, velocities, accelerations)
    faster = quintic.most_beyond(points.velocities, partner.limits.velocity)
    harder = quintic.most_beyond(points.accelerations, partner.limits.acceleration)
    by = max(1.0, faster, math.sqrt(harder))
    return slower(timed, by), slower(follows, by)


def _follow(partner: ArmModel, poses: Sequence[Array], start: Array, margin_rad: float) -> Array:
    margin_rad = max(0.0, min(margin_rad, partner.limit_margin_rad(start)))
    rows = np.vstack((start, partner.ik_along(np.asarray(poses[1:]), start)))
    if len(rows) < len(poses):
        why = partner.why_no_ik(poses[len(rows)], margin_rad) or partner.why_not_within(rows[-1], math.pi)
        assert why is not None, "no solutions, and yet nothing is wrong"
        raise Refused(why)
    for row in rows:
        refuse_if(partner.why_not_within(row, margin_rad - 1e-9))
    return rows


def _rates(arm: ArmModel, q: Array, rates: Array, partner: ArmModel, theirs: Array) -> Array:
    """Joint rates of the partner (rad/s), so that its hand moves with the hand of the arm as one body."""
    twist = arm.jacobian(q) @ rates
    across = partner.fk(theirs)[:3] - arm.fk(q)[:3]
    linear = twist[:3] + np.cross(twist[3:], across)
    rates_of_all = np.linalg.lstsq(partner.jacobian(theirs), np.concatenate((linear, twist[3:])), rcond=None)[0]
    return np.asarray(rates_of_all, dtype=float)
