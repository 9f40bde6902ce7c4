"""The motion of a second arm that holds the same object as the planned arm: a closed chain. Pure.

The hand of the second arm keeps its pose in the axes of the first hand, so both hold the object as they do now.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rtc.protocol.outcomes import Refusal
from rtc.robot import geometry, quintic
from rtc.robot.geometry import Array, Floats
from rtc.robot.kinematics import ArmModel
from workers.planning.motion.timing import Timed


def carry_along(
    arm: ArmModel, timed: Timed, partner: ArmModel, start: Floats, margin_rad: float
) -> tuple[Timed, Timed] | Refusal:
    """The motion of `arm`, and that of `partner` from `start` (rad); both are slowed if the partner needs it.

    Refused if the partner cannot follow: reach, joint limits within `margin_rad`, or a leap near a singularity.
    """
    hand = geometry.relative(arm.fk(timed.positions[0]), partner.fk(start))
    poses = [geometry.compose(arm.fk(q), hand) for q in timed.positions]
    positions = _follow(partner, poses, np.asarray(start, dtype=float), margin_rad)
    if isinstance(positions, Refusal):
        return positions
    velocities = np.array(
        [_rates(arm, q, qd, partner, p) for q, qd, p in zip(timed.positions, timed.velocities, positions, strict=True)]
    )
    accelerations = np.gradient(velocities, timed.time_s, axis=0, edge_order=2)
    velocities[[0, -1]] = accelerations[[0, -1]] = 0.0
    follows = Timed(timed.space, timed.time_s, positions, velocities, accelerations)
    points = quintic.control_points(follows.time_s, positions, velocities, accelerations)
    faster = quintic.most_beyond(points.velocities, partner.limits.velocity)
    harder = quintic.most_beyond(points.accelerations, partner.limits.acceleration)
    by = max(1.0, faster, math.sqrt(harder))
    return slower(timed, by), slower(follows, by)


def slower(timed: Timed, by: float) -> Timed:
    """The motion on the same path in `by` times the time."""
    return Timed(
        timed.space, timed.time_s * by, timed.positions, timed.velocities / by, timed.accelerations / (by * by)
    )


def _follow(partner: ArmModel, poses: Sequence[Array], start: Array, margin_rad: float) -> Array | Refusal:
    margin_rad = max(0.0, min(margin_rad, partner.limit_margin_rad(start)))
    rows = np.vstack((start, partner.follow_all(np.asarray(poses[1:]), start)))
    if len(rows) < len(poses):
        return partner.why_no_ik(poses[len(rows)], margin_rad) or partner.why_not_within(rows[-1], math.pi)  # type: ignore[return-value]
    for row in rows:
        if (why := partner.why_not_within(row, margin_rad - 1e-9)) is not None:
            return why
    return rows


def _rates(arm: ArmModel, q: Array, rates: Array, partner: ArmModel, theirs: Array) -> Array:
    """Joint rates of the partner (rad/s), so that its hand moves with the hand of the arm as one body."""
    twist = arm.jacobian(q) @ rates
    across = partner.fk(theirs)[:3] - arm.fk(q)[:3]
    linear = twist[:3] + np.cross(twist[3:], across)
    rates_of_all = np.linalg.lstsq(partner.jacobian(theirs), np.concatenate((linear, twist[3:])), rcond=None)[0]
    return np.asarray(rates_of_all, dtype=float)
