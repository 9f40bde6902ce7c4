"""Stop functions: the stop conditions of a primitive, compiled to memoryless checks (F in the paper; R66, A21).

`compile_stops` returns the checks in their fixed priority; `first` returns the first one that is true, and only that
one (R83). A check sees the current `Moment` only, except those that compare it with the start of the primitive, and
`_Fallen`, which remembers that a value has been high. The executor carries out the reflex (stop, retreat, comply).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import msgspec

from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.spatial.solid_boxes import Beside
from rtc.subsystems.motion.arm import TICK_S, Traits
from rtc.subsystems.motion.clearance import Clearance
from rtc.subsystems.motion.moment import Finding, Moment

Check = Callable[[Moment], Finding | None]
Stops = list[tuple[p.StopFunction, Check]]

# Checked in every primitive, in addition to its own: they detect a fault of the machine or of its model, not of the
# task. Greatest values measured in pybullet: 0.6 of a speed limit; 6 mrad of following error, placing a module.
# A compliant arm is pushed away from its command on purpose, so its spring may be stretched further.
RIGID_RAD, COMPLIANT_RAD = 0.1, 0.5
# A joint that a brake holds: measured below 0.1 mrad/s, and more than 20 mrad off once another joint is 0.1 rad off.
STUCK_RAD, STILL_RAD_S, MOVING_RAD_S = 0.01, 0.002, 0.05
GRIPPED_S = 0.02  # time for which a grip force must have fallen, while the hand closes
LOAD_TICKS = 5
FARTHER_M = 0.005  # out of its range a load may come that begins outside: as much as the plan's range is narrower
RELAXED_S = 0.2  # until then a hand that an earlier command closed more strongly has taken up its new force


def always(primitive: p.Primitive) -> list[p.StopFunction]:
    limit_rad = RIGID_RAD if primitive.control_law.compliance is None else COMPLIANT_RAD
    return [
        p.StopFunction(reason=StopReason.ARM_CONTACT, when=p.ArmTouch()),
        p.StopFunction(reason=StopReason.OVERSPEED, when=p.SpeedAbove(1.5)),
        p.StopFunction(reason=StopReason.FOLLOWING_ERROR, when=p.FollowingErrorAbove(limit_rad)),
    ]


# After these reasons only the reflex STOP is safe.
STOP_ONLY = frozenset(
    {
        StopReason.HALT,
        StopReason.ARM_CONTACT,
        StopReason.COMMAND_LIMIT,
        StopReason.OVERSPEED,
        StopReason.FOLLOWING_ERROR,
    }
)


def compile_stops(primitive: p.Primitive, traits: Traits) -> Stops:
    """The checks of a primitive by priority. Raises ValueError for a condition that cannot be checked."""
    stops: Stops = []
    for stop in p.in_priority([*primitive.stop_functions, *always(primitive)]):
        for problem in _problems(stop.when):
            raise ValueError(problem)
        stops.append((stop, CHECKS[type(stop.when)](stop.when, traits)))
    return stops


Reports = list[tuple[int, Check]]


def compile_reports(primitive: p.Primitive, traits: Traits) -> Reports:
    """The conditions of R with their numbers. Raises ValueError for one that cannot be checked."""
    conditions: Reports = []
    for condition in primitive.reporting.when:
        for problem in _problems(condition.when):
            raise ValueError(problem)
        conditions.append((condition.n, CHECKS[type(condition.when)](condition.when, traits)))
    return conditions


def first(stops: Stops, moment: Moment) -> tuple[p.StopFunction, Finding] | None:
    """The stop function that ends the primitive now, with its finding, or None."""
    for stop, check in stops:
        finding = check(moment)
        if finding is not None:
            return _with_reflex(stop, stops, moment), finding
    return None


# Watched while the arm backs off too. The others would end a retreat that does what it should.
IN_RETREAT = frozenset({StopReason.COLLISION, StopReason.JOINT_LIMIT, StopReason.FORCE_LIMIT, StopReason.TORQUE_LIMIT})
IN_RETREAT |= {StopReason.OVERSPEED, StopReason.FOLLOWING_ERROR, StopReason.OUT_OF_RANGE}


class RetreatWatch:
    """The conditions of F while the arm backs off. One that is true at the start counts once it has been false."""

    def __init__(self, stops: Stops) -> None:
        self._stops = [(stop, check) for stop, check in stops if stop.reason in IN_RETREAT]
        self._armed = [False] * len(self._stops)

    def first(self, moment: Moment) -> tuple[StopReason, Finding] | None:
        """The first condition that has become true."""
        for n, (stop, check) in enumerate(self._stops):
            finding = check(moment)
            if finding is None:
                self._armed[n] = True
            elif self._armed[n]:
                return stop.reason, finding
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
                return (
                    abs(speed),
                    limits[n],
                    f"{names[n]} turns at {speed:.2f} rad/s; {limits[n]:.3g} rad/s is the limit",
                )
        return None

    return check


def _following(when: p.FollowingErrorAbove, traits: Traits) -> Check:
    names, limit = traits.joint_names, when.limit_rad

    def shown(n: int, value: float) -> str:
        return f"{1e3 * value:.1f} mm" if traits.slides and traits.slides[n] else f"{math.degrees(value):.1f} deg"

    def check(now: Moment) -> Finding | None:
        commanded = now.commanded
        for n, q in enumerate(now.joints):
            if not -limit <= q - commanded[n] <= limit:
                off, stuck = q - commanded[n], _stuck(now)
                cause = f"{names[stuck]} does not move; " if stuck is not None else ""
                found = f"{cause}{names[n]} is {shown(n, off)} from where it is commanded to be"
                return abs(off), limit, f"{found}; {shown(n, limit)} is the limit"
        return None

    return check


def _stuck(now: Moment) -> int | None:
    """The joint that stands still away from its command while others move.

    A stuck joint pulls the lighter joints after it off their commands before it is far from its own.
    """
    if max(map(abs, now.velocities)) < MOVING_RAD_S:
        return None  # all stand: something blocks the arm
    off = [abs(q - wanted) for q, wanted in zip(now.joints, now.commanded, strict=True)]
    still = [n for n, speed in enumerate(now.velocities) if abs(speed) < STILL_RAD_S and off[n] > STUCK_RAD]
    return max(still, key=off.__getitem__, default=None)


def _joint_margin(when: p.JointMarginBelow, traits: Traits) -> Check:
    margins, names = traits.margins(when.margin_rad), traits.joint_names
    lower = [low + margin for low, margin in zip(traits.lower, margins, strict=True)]
    upper = [high - margin for high, margin in zip(traits.upper, margins, strict=True)]

    def check(now: Moment) -> Finding | None:
        for n, q in enumerate(now.joints):
            if lower[n] <= q <= upper[n]:
                continue
            left = margins[n] + min(q - lower[n], upper[n] - q)
            if (now.velocities[n] < 0.0) is (q < lower[n]) and now.velocities[n] != 0.0:
                far = f"{math.degrees(left):.2f} deg" if margins[n] == when.margin_rad else f"{1e3 * left:.1f} mm"
                return left, margins[n], f"{names[n]} is {far} from its limit"
        return None

    return check


def _arm_touch(when: p.ArmTouch, traits: Traits) -> Check:
    return lambda now: (None, None, words) if (words := now.arm_touch()) else None


def _body_touch(when: p.BodyTouch, traits: Traits) -> Check:
    return lambda now: (None, None, words) if (words := now.touch()) else None


def _grip(when: p.GripForceBelow, traits: Traits) -> Check:
    limit = when.limit_n
    if when.once_above:
        return _Fallen(lambda now: now.grip_n, limit, limit, GRIPPED_S)
    return lambda now: (now.grip_n, limit, "") if now.grip_n < limit else None


def _width(when: p.HandWidthBelow, traits: Traits) -> Check:
    limit = when.limit_m
    return lambda now: (now.width_m, limit, "") if now.width_m < limit else None


def _grip_above(when: p.GripForceAbove, traits: Traits) -> Check:
    limit = when.limit_n
    return lambda now: (
        (most, limit, "") if now.elapsed_s > RELAXED_S and (most := max(now.finger_forces)) > limit else None
    )


def _tcp_near(when: p.TcpNear, traits: Traits) -> Check:
    distance, limit = _distance(when), when.distance_m
    return lambda now: (away, limit, "") if (away := distance(now)) < limit else None


def _tcp_far(when: p.TcpFar, traits: Traits) -> Check:
    distance, limit = _distance(when), when.distance_m
    return lambda now: (away, limit, "") if (away := distance(now)) > limit else None


def _distance(when: p.TcpNear | p.TcpFar) -> Callable[[Moment], float]:
    """Distance of the tcp from the point: straight, or along the axis."""
    point = when.point
    if when.axis is None:
        return lambda now: math.dist(point, now.tcp()[:3].tolist())
    axis = when.axis
    return lambda now: abs(sum(a * (q - at) for a, q, at in zip(axis, now.tcp()[:3].tolist(), point, strict=True)))


def _tcp_speed(when: p.TcpSpeedAbove, traits: Traits) -> Check:
    limit = when.limit_m_s
    most = f"{1e3 * limit:.3g} mm/s is the limit"

    def check(now: Moment) -> Finding | None:
        speed = now.tcp_speed_m_s()
        return (speed, limit, f"the tool moves at {1e3 * speed:.3g} mm/s; {most}") if speed > limit else None

    return check


def _outside(when: p.TcpOutside, traits: Traits) -> Check:
    beyond, limit_m = _beyond(when), list[float]()
    load = Beside(when.load, when.centre, when.size_m) if when.load else None
    words, of_load = "the tool is outside its range", "what the hand holds is outside its range"

    def check(now: Moment) -> Finding | None:
        if (far := beyond(now)) > 0.0:
            return far, 0.0, words
        if load is None:
            return None
        far = load.beyond_m(now.tcp())
        if not limit_m:
            limit_m.append(max(0.0, far + FARTHER_M))
        return (far, limit_m[0], of_load) if far > limit_m[0] else None

    return check


def _inside(when: p.TcpInside, traits: Traits) -> Check:
    beyond, load = _beyond(when), _LoadInside(when) if when.load else None
    words = "the tool is inside a region that it must avoid"

    def check(now: Moment) -> Finding | None:
        if (far := beyond(now)) < 0.0:
            return -far, 0.0, words
        return None if load is None else load(now)

    return check


class _LoadInside:
    """Whether what the hand holds is inside a region, seen in every `LOAD_TICKS`th tick: a look takes up to 0.2 ms."""

    def __init__(self, when: p.TcpInside) -> None:
        self._load, self._wait = Beside(when.load, when.centre, when.size_m), 0
        self._found: Finding | None = None

    def __call__(self, now: Moment) -> Finding | None:
        if self._wait > 0:
            self._wait -= 1
            return self._found
        self._wait, deep = LOAD_TICKS - 1, self._load.inside_m(now.tcp())
        self._found = (deep, 0.0, "what the hand holds is inside a region that it must avoid") if deep > 0.0 else None
        return self._found


def _beyond(when: p.TcpOutside | p.TcpInside) -> Callable[[Moment], float]:
    """Distance (m) of the tcp beyond the nearest face of the box, as if the face had no edges; negative inside."""
    back, half = geometry.inverse(when.centre), [0.5 * size for size in when.size_m]

    def beyond(now: Moment) -> float:
        local = geometry.transform_point(back, now.tcp()[:3]).tolist()
        return max(abs(x) - h for x, h in zip(local, half, strict=True))

    return beyond


def _turned(when: p.TcpTurned, traits: Traits) -> Check:
    wanted, limit = [0.0, 0.0, 0.0, *when.attitude], when.limit_rad

    def check(now: Moment) -> Finding | None:
        off = geometry.angle(now.tcp(), wanted)
        return (off, limit, f"the tool is turned by {math.degrees(off):.1f} deg") if off > limit else None

    return check


def _no_progress(when: p.NoProgress, traits: Traits) -> Check:
    limit, force = when.behind_m, when.force_n

    def check(now: Moment) -> Finding | None:
        if now.force_n <= force:  # the cheap half first
            return None
        behind = geometry.distance(now.tcp(), now.commanded_tcp())
        words = f"no progress: {1e3 * behind:.0f} mm behind its command with {now.force_n:.0f} N"
        return (behind, limit, words) if behind > limit else None

    return check


def _joint_turn(when: p.JointTurnAbove, traits: Traits) -> Check:
    if not 0 <= when.joint < len(traits.joint_names):
        raise ValueError(f"JointTurnAbove.joint: {traits.name} has no joint {when.joint}")
    n, limit, name = when.joint, when.limit_rad, traits.joint_names[when.joint]
    start: list[float] = []

    def check(now: Moment) -> Finding | None:
        if not start:
            start.append(now.joints[n])
        turned = abs(now.joints[n] - start[0])
        return (turned, limit, f"{name} has turned by {math.degrees(turned):.1f} deg") if turned > limit else None

    return check


class _Turn:
    """The turn since the first call, see TurnAbove."""

    def __init__(self, when: p.TurnAbove) -> None:
        self._when = when
        self._last: Array | None = None
        self._start: Array | None = None
        self._turned = 0.0

    def __call__(self, now: Moment) -> Finding | None:
        turned = abs(self._turn(now.tcp()))
        limit = self._when.limit_rad
        return (turned, limit, f"it has turned by {math.degrees(turned):.1f} deg") if turned > limit else None

    def _turn(self, tcp: Array) -> float:
        if self._last is None or self._start is None:
            self._last = self._start = tcp
            return 0.0
        when, last, self._last = self._when, self._last, tcp
        if when.axis is None:
            return geometry.angle(self._start, tcp)
        if when.point is None:
            turn = geometry.rotation_vector(last, tcp).tolist()
            self._turned += sum(a * b for a, b in zip(when.axis, turn, strict=True))
        else:
            self._turned += _angle_about(when.axis, _off(when.point, last), _off(when.point, tcp))
        return self._turned


def _off(point: Sequence[float], pose: Array) -> list[float]:
    return [q - at for q, at in zip(pose[:3].tolist(), point, strict=True)]


def _angle_about(axis: Sequence[float], before: Sequence[float], after: Sequence[float]) -> float:
    """The signed angle from one direction to another, seen along the axis."""
    (x, y, z), (a, b, c), (d, e, f) = axis, before, after
    sine = x * (b * f - c * e) + y * (c * d - a * f) + z * (a * e - b * d)
    along_before, along_after = x * a + y * b + z * c, x * d + y * e + z * f
    return math.atan2(sine, a * d + b * e + c * f - along_before * along_after)


class _Fallen:
    """True when a value has been below its limit for some ticks, after it has been above `armed` once."""

    def __init__(self, value: Callable[[Moment], float], limit: float, armed: float, for_s: float) -> None:
        self._value, self._limit, self._armed_at = value, limit, armed
        self._needed = max(1, round(for_s / TICK_S))
        self._armed = False
        self._below = 0

    def __call__(self, now: Moment) -> Finding | None:
        value = self._value(now)
        self._armed = self._armed or value > self._armed_at
        self._below = self._below + 1 if value < self._limit else 0
        return (value, self._limit, "") if self._armed and self._below >= self._needed else None


def _force_below(when: p.ForceBelow, traits: Traits) -> Check:
    part = _part(when.axis, 0)
    armed = when.limit_n if when.armed_n is None else when.armed_n
    value = (lambda now: now.force_n) if part is None else (lambda now: abs(part(now.wrench)))
    return _Fallen(value, when.limit_n, armed, when.for_s)


def _torque_below(when: p.TorqueBelow, traits: Traits) -> Check:
    part = _part(when.axis, 3)
    value = (lambda now: now.torque_nm) if part is None else (lambda now: abs(part(now.wrench)))
    return _Fallen(value, when.limit_nm, when.limit_nm, when.for_s)


def _unseen(when: p.UnseenAbove, traits: Traits) -> Check:
    raise ValueError(f"UnseenAbove: {traits.name} is an arm, and sees nothing")


CHECKS: dict[type, Callable[[Any, Traits], Check]] = {
    p.GoalReached: _goal,
    p.TimeAbove: _time,
    p.ForceAbove: _force,
    p.TorqueAbove: _torque,
    p.SpeedAbove: _speed,
    p.FollowingErrorAbove: _following,
    p.JointMarginBelow: _joint_margin,
    p.ArmTouch: _arm_touch,
    p.BodyTouch: _body_touch,
    p.GripForceBelow: _grip,
    p.HandWidthBelow: _width,
    p.TcpNear: _tcp_near,
    p.ForceBelow: _force_below,
    p.TorqueBelow: _torque_below,
    p.NoProgress: _no_progress,
    p.GripForceAbove: _grip_above,
    p.TcpFar: _tcp_far,
    p.TcpSpeedAbove: _tcp_speed,
    p.TcpOutside: _outside,
    p.TcpInside: _inside,
    p.TcpTurned: _turned,
    p.TurnAbove: lambda when, traits: _Turn(when),
    p.JointTurnAbove: _joint_turn,
    p.ClearanceBelow: lambda when, traits: Clearance(when),
    p.UnseenAbove: _unseen,
}


LENGTHS = {"centre": 7, "attitude": 4}  # of lists; all others have three numbers
LISTS = ("except_near", "load")  # fields that are lists of vectors
UNIT_SLACK = 1e-3  # of the length of an axis: rounding of its numbers
# True below a limit: with the limit 0 they are never true. HandWidthBelow may be so: a closed hand that is believed to
# hold something has to move too.
BELOW = (p.ForceBelow, p.TorqueBelow, p.GripForceBelow, p.TcpNear, p.ClearanceBelow)


def _problems(when: p.Predicate) -> Iterator[str]:
    """Errors that the types do not exclude."""
    kind = type(when).__name__
    fields = {field: value for field, value in msgspec.structs.asdict(when).items() if field not in LISTS}
    for name in LISTS:
        for n, vector in enumerate(getattr(when, name, [])):
            if not all(math.isfinite(x) for x in vector):
                yield f"{kind}.{name}[{n}]: not a finite number"
    for field, value in fields.items():
        if isinstance(value, list) and len(value) != LENGTHS.get(field, 3):
            yield f"{kind}.{field}: {LENGTHS.get(field, 3)} numbers are needed, not {len(value)}"
        numbers = value if isinstance(value, list) else [] if value is None else [value]
        if not all(math.isfinite(n) for n in numbers):
            yield f"{kind}.{field}: not a finite number"
        if field in ("centre", "attitude") and not any(value[-4:]):
            yield f"{kind}.{field}: four zeros are not an attitude"
        if field == "axis" and value is not None and abs(math.hypot(*value) - 1.0) > UNIT_SLACK:
            yield f"{kind}.axis: a unit vector is needed; {value} has the length {math.hypot(*value):.3g}"
        if field == "size_m" and min(value) <= 0.0:
            yield f"{kind}.size_m: a box has three sides above 0, not {value}"
        if not isinstance(value, list) and min(numbers, default=0.0) < 0.0:
            yield f"{kind}.{field}: {value:g} is below 0"
        if isinstance(when, BELOW) and field in ("limit_n", "limit_nm", "limit_m", "distance_m") and value <= 0.0:
            yield f"{kind}.{field}: nothing is below {value:g}"
