"""Motions of two arms that hold one object: a closed chain. Pure.

The second arm is the partner. Its hand keeps its pose in the axes of the first hand, so both hold the object as they do
now. The first hand moves in a straight line.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec
import numpy as np
from msgspec.structs import replace

from rtc.model.robot import quintic
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.outcomes import Refusal, Refused, refuse_if
from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats
from workers.planning.motion.path import task_line
from workers.planning.motion.plan import Motion
from workers.planning.motion.request import PlanningRequest
from workers.planning.motion.timing import Timed, slower, time_path

SLACK_M = 0.0003  # tolerance of the distance of bodies that are near at the start


def plan_carry(request: PlanningRequest, goal_pose: Floats) -> Motion:
    """A straight line of the hand to `goal_pose` (world), with the partner of the request. Raises Refused."""
    arm, partner = request.arm, request.partner
    assert partner is not None
    line = task_line(arm, request.start, goal_pose, request.way_margin_rad)
    timed = time_path(arm, line, request.pace, request.load)
    leads, follows = carry_along(arm, timed, partner, request.joints[partner.name], request.margin_rad)
    refuse_if(_fault(request, partner, leads, follows))
    notes = [f"generated a straight line of the hand, and the way of {partner.name} with it; tested: free"]
    goal = line.knots[-1]
    return Motion(line, leads, goal, arm.fk(goal), notes, partner=follows)


def _fault(request: PlanningRequest, partner: ArmModel, leads: Timed, follows: Timed) -> Refusal | None:
    """The first collision or broken rule while both arms move; None if there is none."""
    scene = request.scene
    hand = request.world.cell.arm(partner.name).gripper
    held = [name for name, by in scene.held.items() if by.arm == request.arm.name]
    touched = [(f"{partner.name} {link}", thing) for link in (hand.palm_link, *hand.finger_links) for thing in held]
    within = replace(request.path_constraints, attitude=None)  # an attitude is that of the first hand
    scene = replace(scene, moving="", ignore=[*scene.ignore, *touched])
    # What is nearer than the clearance already comes no nearer.
    near = sorted(request.world.too_near(request.joints, scene), key=lambda hit: -hit.distance_m)
    scene = replace(scene, close={(hit.body_a, hit.body_b): hit.distance_m - SLACK_M for hit in near})
    for n, (q, theirs) in enumerate(zip(leads.positions, follows.positions, strict=True)):
        hit = request.world.check({**request.joints, request.arm.name: q, partner.name: theirs}, scene)
        problem = hit.refusal() if hit is not None else request.path_constraints.violation(request.arm, q)
        problem = problem or within.violation(partner, theirs)
        if problem is not None:
            share = n / max(1, len(leads.positions) - 1)
            return msgspec.structs.replace(
                problem,
                message=f"{problem.message} ({share:.0%} along the way)",
                detail={**problem.detail, "fraction": share},
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
