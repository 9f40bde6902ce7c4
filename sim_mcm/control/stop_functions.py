"""Stop functions: the stop conditions of a primitive, compiled to memoryless checks (F in the paper; R66, A21).

`compile_stops` returns the checks in their fixed priority; `first` returns the first one that is true, and only that
one (R83). A check sees the current `Moment` only. The executor carries out the reflex (stop, retreat).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import msgspec

from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.robot.geometry import Array
from sim_mcm.arms.arm import Traits

Finding = tuple[float | None, float | None, str]  # measured, limit, words


class Moment(msgspec.Struct):
    """The input of a check: the sample of this tick with the bias subtracted from the wrench, and derived values."""

    elapsed_s: float
    joints: list[float]
    velocities: list[float]
    wrench: list[float]
    force_n: float  # magnitudes
    torque_nm: float
    width_m: float
    grip_n: float  # force of the finger that presses less
    arrived: Finding | None  # (greatest error, tolerance, '') once the goal is reached
    tcp: Callable[[], Array]  # called on demand: tcp and touch cost more than the other values
    touch: Callable[[], str]
    commanded: list[float]  # commanded joints of this tick (rad)


Check = Callable[[Moment], Finding | None]
Stops = list[tuple[p.StopFunction, Check]]

# Checked in every primitive, in addition to its own: they detect a fault of the machine or of its model, not of the
# task. Greatest values measured in pybullet: 0.6 of a speed limit; 6 mrad of following error, placing a module.
# A compliant arm is pushed away from its command on purpose, so its spring may be stretched further.
RIGID_RAD, COMPLIANT_RAD = 0.1, 0.5


def always(primitive: p.Primitive) -> list[p.StopFunction]:
    limit_rad = RIGID_RAD if primitive.control_law.compliance is None else COMPLIANT_RAD
    return [
        p.StopFunction(reason=StopReason.OVERSPEED, when=p.SpeedAbove(1.5)),
        p.StopFunction(reason=StopReason.FOLLOWING_ERROR, when=p.FollowingErrorAbove(limit_rad)),
    ]


# After these reasons only the reflex STOP is safe.
STOP_ONLY = frozenset({StopReason.HALT, StopReason.COMMAND_LIMIT, StopReason.OVERSPEED, StopReason.FOLLOWING_ERROR})


def compile_stops(primitive: p.Primitive, traits: Traits) -> Stops:
    """The checks of a primitive by priority. Raises ValueError for a condition that cannot be checked."""
    stops: Stops = []
    for stop in p.in_priority([*primitive.stop_functions, *always(primitive)]):
        for problem in _problems(stop):
            raise ValueError(problem)
        stops.append((stop, CHECKS[type(stop.when)](stop.when, traits)))
    return stops


def first(stops: Stops, moment: Moment) -> tuple[p.StopFunction, Finding] | None:
    """The stop function that ends the primitive now, with its finding, or None."""
    for stop, check in stops:
        finding = check(moment)
        if finding is not None:
            return _with_reflex(stop, stops, moment), finding
    return None


def _with_reflex(stop: p.StopFunction, stops: Stops, moment: Moment) -> p.StopFunction:
    """`stop` with the reflex of the first true condition whose reflex is more than STOP. So a requested reflex does
    not depend on which of two exceeded limits is reported."""
    if stop.reflex is not Reflex.STOP or stop.reason in STOP_ONLY:
        return stop
    for other, check in stops:
        if other.reflex is not Reflex.STOP and check(moment) is not None:
            return msgspec.structs.replace(stop, reflex=other.reflex, back_off_m=other.back_off_m)
    return stop


# --- one factory per type of condition ------------------------------------------------------------------


def _goal(when: p.GoalReached, traits: Traits) -> Check:
    return lambda now: now.arrived


def _time(when: p.TimeAbove, traits: Traits) -> Check:
    limit = when.limit_s
    return lambda now: (now.elapsed_s, limit, "") if now.elapsed_s > limit else None


def _force(when: p.ForceAbove, traits: Traits) -> Check:
    limit, part = when.limit_n, _part(when.axis, 0)
    if part is None:
        return lambda now: (now.force_n, limit, "") if now.force_n > limit else None
    return lambda now: (value, limit, "") if (value := part(now.wrench)) > limit else None


def _torque(when: p.TorqueAbove, traits: Traits) -> Check:
    limit, part = when.limit_nm, _part(when.axis, 3)
    if part is None:
        return lambda now: (now.torque_nm, limit, "") if now.torque_nm > limit else None
    return lambda now: (value, limit, "") if (value := part(now.wrench)) > limit else None


def _part(axis: Sequence[float] | None, first_entry: int) -> Callable[[list[float]], float] | None:
    if axis is None:
        return None
    (x, y, z), i, j, k = axis, first_entry, first_entry + 1, first_entry + 2
    return lambda wrench: x * wrench[i] + y * wrench[j] + z * wrench[k]


def _speed(when: p.SpeedAbove, traits: Traits) -> Check:
    names, limits = traits.joint_names, [when.ratio * limit for limit in traits.velocity]

    def check(now: Moment) -> Finding | None:
        for n, speed in enumerate(now.velocities):
            if not -limits[n] <= speed <= limits[n]:
                return abs(speed), limits[n], f"{names[n]} turns at {speed:.2f} rad/s"
        return None

    return check


def _following(when: p.FollowingErrorAbove, traits: Traits) -> Check:
    names, limit = traits.joint_names, when.limit_rad

    def check(now: Moment) -> Finding | None:
        commanded = now.commanded
        for n, q in enumerate(now.joints):
            if not -limit <= q - commanded[n] <= limit:
                off = q - commanded[n]
                return abs(off), limit, f"{names[n]} is {math.degrees(off):.1f} deg from where it is commanded to be"
        return None

    return check


def _joint_margin(when: p.JointMarginBelow, traits: Traits) -> Check:
    margin, names = when.margin_rad, traits.joint_names
    lower = [low + margin for low in traits.lower]
    upper = [high - margin for high in traits.upper]

    def check(now: Moment) -> Finding | None:
        for n, q in enumerate(now.joints):
            if lower[n] <= q <= upper[n]:
                continue
            left = margin + min(q - lower[n], upper[n] - q)
            if (now.velocities[n] < 0.0) is (q < lower[n]) and now.velocities[n] != 0.0:
                return left, margin, f"{names[n]} is {math.degrees(left):.2f} deg from its limit"
        return None

    return check


def _body_touch(when: p.BodyTouch, traits: Traits) -> Check:
    return lambda now: (None, None, words) if (words := now.touch()) else None


def _grip(when: p.GripForceBelow, traits: Traits) -> Check:
    limit = when.limit_n
    return lambda now: (now.grip_n, limit, "") if now.grip_n < limit else None


def _width(when: p.HandWidthBelow, traits: Traits) -> Check:
    limit = when.limit_m
    return lambda now: (now.width_m, limit, "") if now.width_m < limit else None


def _tcp_near(when: p.TcpNear, traits: Traits) -> Check:
    (x, y, z), limit = when.point, when.distance_m

    def check(now: Moment) -> Finding | None:
        at = now.tcp()
        distance = math.dist((x, y, z), at[:3].tolist())
        return (distance, limit, "") if distance < limit else None

    return check


CHECKS: dict[type, Callable[[Any, Traits], Check]] = {
    p.GoalReached: _goal,
    p.TimeAbove: _time,
    p.ForceAbove: _force,
    p.TorqueAbove: _torque,
    p.SpeedAbove: _speed,
    p.FollowingErrorAbove: _following,
    p.JointMarginBelow: _joint_margin,
    p.BodyTouch: _body_touch,
    p.GripForceBelow: _grip,
    p.HandWidthBelow: _width,
    p.TcpNear: _tcp_near,
}


def _problems(stop: p.StopFunction) -> Iterator[str]:
    """Errors that the types do not exclude."""
    kind = type(stop.when).__name__
    for field, value in msgspec.structs.asdict(stop.when).items():
        if isinstance(value, list) and len(value) != 3:
            yield f"{kind}.{field}: three numbers are needed, not {len(value)}"
        numbers = value if isinstance(value, list) else [] if value is None else [value]
        if not all(math.isfinite(n) for n in numbers):
            yield f"{kind}.{field}: not a finite number"
