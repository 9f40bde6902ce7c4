"""F of a primitive: predicates over the current sample, each with its stop reason and its reflex (R66).

A predicate has no filter unless it states one. One that is true for a value below a limit counts only after the value
has been above it in the same primitive. The reason: every motion begins without force.
"""

from __future__ import annotations

from collections.abc import Iterable

from rtc.protocol.outcomes import PRIORITY, Reflex, StopReason
from rtc.protocol.primitive.limits import FARTHEST_M, MAX_S, Vector
from rtc.protocol.strict import Strict


class GoalReached(Strict, frozen=True, tag="goal-reached", omit_defaults=True):
    """The trajectory is complete and the arm has settled. Of a hand: it has its width, or presses with its force. Of a
    camera: it has its pose, or has followed the body for the duration.

    `within_m`: so near the end of its path a compliant arm at rest has reached it, because a load stretches its spring;
    None: as near as a position-controlled arm."""

    within_m: float | None = None

    def __post_init__(self) -> None:
        if self.within_m is not None and not 0.0 < self.within_m <= FARTHEST_M:  # false for nan too
            raise ValueError(f"a goal is reached within {self.within_m} m: more than 0, at most {FARTHEST_M:g} m")


class TimeAbove(Strict, frozen=True, tag="time-above"):
    limit_s: float  # since the start of the primitive, in the time of the simulation, without pauses

    def __post_init__(self) -> None:
        if not 0.0 <= self.limit_s <= MAX_S:  # false for nan too
            raise ValueError(f"a time limit of {self.limit_s} s: 0 to {MAX_S:g} s is possible")


class ForceAbove(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="force-above"):
    """Wrist force beyond a limit: its magnitude, or its part along `axis` (unit vector, tool axes)."""

    limit_n: float
    axis: Vector | None = None


class TorqueAbove(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="torque-above"):
    limit_nm: float
    axis: Vector | None = None


class ForceBelow(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="force-below"):
    """Wrist force below a limit for `for_s`, after it has been above `armed_n` (default: the limit)."""

    limit_n: float
    armed_n: float | None = None
    axis: Vector | None = None  # as in ForceAbove; then the magnitude of that part
    for_s: float = 0.02


class TorqueBelow(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="torque-below"):
    limit_nm: float
    axis: Vector | None = None
    for_s: float = 0.02


class NoProgress(Strict, frozen=True, kw_only=True, tag="no-progress"):
    """The tcp is farther than this behind its command, while the wrist force is above a limit: a compliant arm jams."""

    behind_m: float
    force_n: float


class SpeedAbove(Strict, frozen=True, tag="speed-above"):
    """A measured joint speed exceeds `ratio` times its limit. The MCM adds one with its own ratio to each primitive."""

    ratio: float


class FollowingErrorAbove(Strict, frozen=True, tag="following-error-above"):
    """A measured joint is farther than this from its command. The MCM adds one with its own limit to each primitive."""

    limit_rad: float


class JointMarginBelow(Strict, frozen=True, tag="joint-margin-below"):
    margin_rad: float  # of the nearest joint limit, moving towards it


class ArmTouch(Strict, frozen=True, tag="arm-touch"):
    """The arm or its hand is in contact with another arm. The MCM adds one to each primitive."""


class BodyTouch(Strict, frozen=True, tag="body-touch"):
    """A link of the arm (not palm or fingers, which may touch) is in contact with anything."""


class GripForceBelow(Strict, frozen=True, omit_defaults=True, tag="grip-force-below"):
    limit_n: float
    once_above: bool = False  # for a hand that closes: counts after it has been above, and then for 20 ms


class GripForceAbove(Strict, frozen=True, tag="grip-force-above"):
    limit_n: float  # of the finger that presses more


class HandWidthBelow(Strict, frozen=True, tag="hand-width-below"):
    limit_m: float  # less than the width of the held object: a narrower hand holds nothing


class TcpNear(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="tcp-near"):
    point: Vector  # world frame, m
    distance_m: float
    axis: Vector | None = None  # unit vector, world: only the distance along it counts


class TcpFar(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="tcp-far"):
    point: Vector  # as in TcpNear
    distance_m: float
    axis: Vector | None = None


class TcpSpeedAbove(Strict, frozen=True, tag="tcp-speed-above"):
    limit_m_s: float  # mean over the last 19 ms


class TcpOutside(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="tcp-outside"):
    """The tcp, or a part of what the hand holds, is outside a box. A load that is at the start comes no farther out."""

    centre: Vector  # pose, world: x y z qx qy qz qw
    size_m: Vector
    load: list[Vector] = []  # boxes round the parts of what the hand holds: x y z qx qy qz qw in tcp axes, sides (m)

    def __post_init__(self) -> None:
        _check_boxes(self.load)


class TcpInside(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="tcp-inside"):
    """The tcp, or a part of what the hand holds, is inside a box."""

    centre: Vector  # as in TcpOutside
    size_m: Vector
    load: list[Vector] = []  # as in TcpOutside

    def __post_init__(self) -> None:
        _check_boxes(self.load)


def _check_boxes(boxes: list[Vector]) -> None:
    for box in boxes:
        if len(box) != 10 or not any(box[3:7]) or min(box[7:]) <= 0.0:
            raise ValueError("a box has a pose of 7 numbers and three sides above 0")


class UnseenAbove(Strict, frozen=True, tag="unseen-above"):
    limit_s: float  # a camera has not seen the body in any of its pictures over this time

    def __post_init__(self) -> None:
        if not 0.0 < self.limit_s <= MAX_S:  # false for nan too
            raise ValueError(f"a limit of {self.limit_s} s without a sight: more than 0, at most {MAX_S:g} s")


class TcpTurned(Strict, frozen=True, kw_only=True, tag="tcp-turned"):
    """The attitude of the tcp differs from the given one by more than `limit_rad`."""

    attitude: Vector  # quaternion x y z w, world
    limit_rad: float


class TurnAbove(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="turn-above"):
    """A turn since the start of the primitive, either way: whole turns are counted.

    Without a point: of the hand about `axis`, or by the whole change of its attitude (at most pi). With a point: of the
    tcp round the line through it along `axis`, such as a hinge.
    """

    limit_rad: float
    axis: Vector | None = None  # unit vector, world
    point: Vector | None = None  # world, m; needs an axis

    def __post_init__(self) -> None:
        if self.point is not None and self.axis is None:
            raise ValueError("a turn round a point needs an axis")


class JointTurnAbove(Strict, frozen=True, kw_only=True, tag="joint-turn-above"):
    """A joint has turned, either way, by more than this since the start of the primitive."""

    joint: int  # index, from the base
    limit_rad: float


class ClearanceBelow(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="clearance-below"):
    """A link of the arm, its hand or what it holds is nearer than this to another body.

    A body that is that near at the start may only get farther. Filter: measured every 20 ms; by hand every 5 ms.
    """

    limit_m: float
    except_near: list[Vector] = []  # balls [x y z radius] (m, world): a nearest point inside one does not count

    def __post_init__(self) -> None:
        if any(len(ball) != 4 for ball in self.except_near):
            raise ValueError("a ball has a centre of 3 numbers and a radius")


Predicate = (
    GoalReached
    | TimeAbove
    | ForceAbove
    | TorqueAbove
    | SpeedAbove
    | FollowingErrorAbove
    | JointMarginBelow
    | ArmTouch
    | BodyTouch
    | GripForceBelow
    | HandWidthBelow
    | TcpNear
    | ForceBelow
    | TorqueBelow
    | NoProgress
    | GripForceAbove
    | TcpFar
    | TcpSpeedAbove
    | TcpOutside
    | TcpInside
    | TcpTurned
    | TurnAbove
    | JointTurnAbove
    | ClearanceBelow
    | UnseenAbove
)


class StopFunction(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """One condition, the reason it gives, and the reflex it triggers."""

    reason: StopReason
    when: Predicate
    reflex: Reflex = Reflex.STOP
    back_off_m: float = 0.0  # for BACK_OFF: back along the path


def in_priority(stops: Iterable[StopFunction]) -> list[StopFunction]:
    """F in the fixed order in which it is evaluated every tick; the first that is true wins (A21)."""
    return sorted(stops, key=lambda stop: PRIORITY[stop.reason])
