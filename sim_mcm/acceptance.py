"""What an arm refuses to begin, and why, in words (R63, R67): a primitive is checked whole before it moves anything.

Pure: (primitive, traits of the arm, where it is) -> the first objection, or ''. Whether the arm is busy, and
whether the control law is known, is asked elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from rtc import primitive as p
from rtc.outcomes import Reflex
from sim_mcm.arm import Traits

START_TOLERANCE_RAD = 0.01  # between where the arm is and where a trajectory begins
REST_RAD_S = 1e-6  # a trajectory begins and ends at rest
LIMIT_SLACK_RAD = 1e-9
VELOCITY_SLACK = 1.001


def objection(primitive: p.Primitive, traits: Traits, joints: Sequence[float]) -> str:
    """The first thing that is wrong with it, or ''."""
    for problem in CHECKS[type(primitive.trajectory)](primitive.trajectory, traits, joints):
        return problem
    for stop in primitive.stop_functions:
        if stop.reflex is Reflex.COMPLY:
            return f"reflex comply of {stop.reason} is not available: this arm has no compliant control yet"
        if not math.isfinite(stop.back_off_m) or stop.back_off_m < 0.0:
            return f"back_off_m of {stop.reason} must be 0 or more, not {stop.back_off_m}"
    if primitive.reporting.every_s is not None and not primitive.reporting.every_s >= 0.001:
        return f"progress reports every {primitive.reporting.every_s} s: 0.001 s is the least"
    return ""


def _joints(trajectory: p.JointTrajectory, traits: Traits, joints: Sequence[float]) -> Iterator[str]:
    names, dof = traits.joint_names, len(traits.joint_names)
    given = len(trajectory.positions[0])
    if given != dof:
        yield f"the trajectory is for {given} joints, {traits.name} has {dof}"
        return
    rows = (*trajectory.positions, *trajectory.velocities, *trajectory.accelerations, trajectory.time_s)
    if not all(math.isfinite(value) for row in rows for value in row):
        yield "the trajectory holds a number that is not finite"
    for name, here, start in zip(names, joints, trajectory.positions[0], strict=True):
        if abs(start - here) > START_TOLERANCE_RAD:
            yield (
                f"the trajectory does not start where {traits.name} is: {name} is at {here:.4f} rad, "
                f"it begins at {start:.4f}, {start - here:+.4f} away ({START_TOLERANCE_RAD} is allowed)"
            )
    for k, row in enumerate(trajectory.positions):
        for name, value, low, high in zip(names, row, traits.lower, traits.upper, strict=True):
            if not low - LIMIT_SLACK_RAD <= value <= high + LIMIT_SLACK_RAD:
                yield f"knot {k} puts {name} to {value:.4f} rad; its limits are {low:.4f} and {high:.4f}"
    for k, row in enumerate(trajectory.velocities):
        for name, value, limit in zip(names, row, traits.velocity, strict=True):
            if abs(value) > limit * VELOCITY_SLACK:
                yield f"knot {k} turns {name} at {value:.3f} rad/s; its limit is {limit:.3f}"
    for where, row in (("start", trajectory.velocities[0]), ("end", trajectory.velocities[-1])):
        if max(abs(v) for v in row) > REST_RAD_S:
            yield f"the trajectory does not {where} at rest"


def _hand(trajectory: p.HandMotion, traits: Traits, joints: Sequence[float]) -> Iterator[str]:
    figures = (
        ("width_m", trajectory.width_m, 0.0, traits.max_opening_m),
        ("force_n", trajectory.force_n, 0.0, traits.max_grip_n),
        ("speed_m_s", trajectory.speed_m_s, 0.001, 4 * traits.hand_speed_m_s),
    )
    for name, value, low, high in figures:
        if not low <= value <= high:  # false for NaN too
            yield f"hand motion: {name} {value} is outside {low} to {high}, what the hand of {traits.name} can do"
    if trajectory.force_n <= 0.0:
        yield "hand motion: force_n must be above 0"


def _still(trajectory: p.HoldStill, traits: Traits, joints: Sequence[float]) -> Iterator[str]:
    if trajectory.duration_s is not None and not trajectory.duration_s >= 0.0:
        yield f"hold still: duration_s must be 0 or more, not {trajectory.duration_s}"


CHECKS: dict[type, Callable[[Any, Traits, Sequence[float]], Iterator[str]]] = {
    p.JointTrajectory: _joints,
    p.HandMotion: _hand,
    p.HoldStill: _still,
}
