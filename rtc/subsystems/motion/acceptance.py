"""Acceptance check of a primitive before any motion; a refusal states its reason (R63, R67).

Pure: (primitive, traits of the arm, joint positions) -> the first objection, or ''. The executor checks whether the arm
is busy and whether the control law is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from rtc.model.robot import quintic
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Reflex
from rtc.subsystems.base import report_items
from rtc.subsystems.motion.arm import Traits

START_TOLERANCE_RAD = 0.01  # maximum distance between the arm and the start of a trajectory
REST_RAD_S = 1e-6  # a trajectory begins and ends at rest
LIMIT_SLACK_RAD = 1e-9
RATE_SLACK = 0.001  # share of a velocity or acceleration limit allowed for rounding
MAX_KNOTS = 10_000  # checking this many takes 20 ms, during which no arm is served


def objection(primitive: p.Primitive, traits: Traits, joints: Sequence[float]) -> str:
    """The first objection to the primitive, or ''."""
    for problem in CHECKS[type(primitive.trajectory)](primitive.trajectory, traits, joints):
        return problem
    if primitive.hand is not None and primitive.hand != traits.hand:
        planned, has = (hand or "no hand" for hand in (primitive.hand, traits.hand))
        return f"the motion was planned with {planned}, and {traits.name} has {has} in its coupler"
    load = primitive.control_law.load
    if load is not None and load.mass_kg > traits.payload_kg:
        return f"a load of {load.mass_kg:g} kg is more than the {traits.payload_kg:g} kg that {traits.name} can carry"
    for stop in primitive.stop_functions:
        if not math.isfinite(stop.back_off_m) or stop.back_off_m < 0.0:
            return f"back_off_m of {stop.reason} must be 0 or more, not {stop.back_off_m}"
        if (stop.reflex is Reflex.BACK_OFF) is not (stop.back_off_m > 0.0):
            return f"back_off_m of {stop.reason} is {stop.back_off_m:g} m with the reflex {stop.reflex.value}"
    if primitive.reporting.every_s is not None and not primitive.reporting.every_s >= 0.001:
        return f"progress reports every {primitive.reporting.every_s} s: 0.001 s is the least"
    added = set(primitive.reporting.items) - set(report_items.STANDARD)
    if added and (unknown := sorted(added - set(report_items.known()))):
        return f"REPORT {', '.join(unknown)}: no package here measures that; install it for the MCM too, and restart"
    return ""


def _joints(trajectory: p.JointTrajectory, traits: Traits, joints: Sequence[float]) -> Iterator[str]:
    names, dof = traits.joint_names, len(traits.joint_names)
    given, knots = len(trajectory.positions[0]), len(trajectory.time_s)
    if given != dof:
        yield f"the trajectory is for {given} joints, {traits.name} has {dof}"
        return
    if knots > MAX_KNOTS:
        yield f"the trajectory has {knots} knots; {MAX_KNOTS} is the maximum"
        return
    q, v, a = (np.asarray(rows) for rows in (trajectory.positions, trajectory.velocities, trajectory.accelerations))
    if not all(np.isfinite(rows).all() for rows in (q, v, a, np.asarray(trajectory.time_s))):
        yield "the trajectory holds a number that is not finite"
        return
    for name, here, start in zip(names, joints, trajectory.positions[0], strict=True):
        if abs(start - here) > START_TOLERANCE_RAD:
            yield (
                f"the trajectory does not start where {traits.name} is: {name} is at {here:.4f} rad, "
                f"the trajectory starts at {start:.4f}, {start - here:+.4f} away ({START_TOLERANCE_RAD} is allowed)"
            )
    for where, row in (("start", trajectory.velocities[0]), ("end", trajectory.velocities[-1])):
        if max(abs(speed) for speed in row) > REST_RAD_S:
            yield f"the trajectory does not {where} at rest"
    yield from _limits(quintic.control_points(trajectory.time_s, q, v, a), traits)


def _limits(points: quintic.ControlPoints, traits: Traits) -> Iterator[str]:
    """Check every segment, between its knots too, against the limits of the arm. Names the first joint that exceeds."""
    velocity, acceleration = np.asarray(traits.velocity), np.asarray(traits.acceleration)
    low, high = np.asarray(traits.lower), np.asarray(traits.upper)
    for what, unit, rows, least, most, slack in (
        ("velocity", "rad/s", points.velocities, -velocity, velocity, velocity * RATE_SLACK),
        ("acceleration", "rad/s^2", points.accelerations, -acceleration, acceleration, acceleration * RATE_SLACK),
        ("position", "rad", points.positions, low, high, LIMIT_SLACK_RAD),
    ):
        found = quintic.excess(rows, least - slack, most + slack)
        if found is not None:
            k = found.joint
            yield (
                f"between knots {found.piece} and {found.piece + 1} the {what} of {traits.joint_names[k]} reaches "
                f"{found.value:.4g} {unit}; its limits are {least[k]:.4f} and {most[k]:.4f}"
            )


def _hand(trajectory: p.HandMotion, traits: Traits, joints: Sequence[float]) -> Iterator[str]:
    figures = (
        ("width_m", trajectory.width_m, 0.0, traits.max_opening_m),
        ("force_n", trajectory.force_n, 0.0, traits.max_grip_n),
        ("speed_m_s", trajectory.speed_m_s, 0.001, 4 * traits.hand_speed_m_s),
    )
    for name, value, low, high in figures:
        if not low <= value <= high:  # false for NaN too
            yield f"hand motion: {name} {value} is outside {low} to {high}, the range of the hand of {traits.name}"
    if trajectory.force_n <= 0.0:
        yield "hand motion: force_n must be above 0"


def _still(trajectory: p.HoldStill, traits: Traits, joints: Sequence[float]) -> Iterator[str]:
    if trajectory.duration_s is not None and not trajectory.duration_s >= 0.0:
        yield f"hold still: duration_s must be 0 or more, not {trajectory.duration_s}"


def _operated(trajectory: p.TeleopMotion, traits: Traits, joints: Sequence[float]) -> Iterator[str]:
    if trajectory.hand and trajectory.grip_n > traits.max_grip_n:
        yield f"a grip of {trajectory.grip_n:g} N is more than the {traits.max_grip_n:g} N of the hand of {traits.name}"
    if trajectory.along is not None:
        yield from _joints(trajectory.along, traits, joints)


def _coupling(trajectory: p.Coupling, traits: Traits, joints: Sequence[float]) -> Iterator[str]:
    if traits.hand is None:
        yield f"{traits.name} has no coupler"
    elif trajectory.hand and traits.hand not in ("", trajectory.hand):
        yield f"{traits.name} has {traits.hand} in its coupler already"


def _look(trajectory: p.Look, traits: Traits, joints: Sequence[float]) -> Iterator[str]:
    yield f"{traits.name} is an arm; only a camera looks"


CHECKS: dict[type, Callable[[Any, Traits, Sequence[float]], Iterator[str]]] = {
    p.JointTrajectory: _joints,
    p.HandMotion: _hand,
    p.HoldStill: _still,
    p.Look: _look,
    p.TeleopMotion: _operated,
    p.Coupling: _coupling,
    p.SpindleMotion: lambda trajectory, traits, joints: iter(()),  # the arm checks it against the driver in its hand
}
