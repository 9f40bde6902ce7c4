"""The primitive as a whole: its four parts, its start conditions, and the part of a second arm."""

from __future__ import annotations

from rtc.protocol.primitive.control_law import ControlLaw
from rtc.protocol.primitive.limits import MAX_FURTHER, MAX_S
from rtc.protocol.primitive.reporting import Reporting
from rtc.protocol.primitive.space import Box
from rtc.protocol.primitive.stop_functions import GoalReached, StopFunction, TimeAbove, in_priority
from rtc.protocol.primitive.trajectory import JointTrajectory, Look, Trajectory
from rtc.protocol.strict import Strict


class StartAfter(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """A start condition: a primitive of another arm has left the space that this one needs first.

    It is met when that primitive has executed its trajectory up to `path_s`, also if it was stopped later than that. It
    cannot be met if that primitive ended earlier, or `within_s` has passed; then nothing starts.

    `further` are conditions of the same kind on the way. The arm stands on its path before the first time of a pair
    until the other one has come to the second. If that cannot be any more, the arm stops where it is.
    """

    primitive: str
    path_s: float  # time along its trajectory
    within_s: float  # maximum time of all waits together, in the time of the simulation
    further: list[tuple[float, float]] = []  # (time along the own path, time along the other's), both increase

    def __post_init__(self) -> None:
        if not (0.0 <= self.path_s <= MAX_S and 0.0 < self.within_s <= MAX_S):  # false for nan too
            raise ValueError(f"a start condition has times of 0 to {MAX_S:g} s")
        own_s, path_s = 0.0, self.path_s
        for pair in self.further:
            if not (own_s < pair[0] <= MAX_S and path_s < pair[1] <= MAX_S):
                raise ValueError(f"conditions on the way increase, up to {MAX_S:g} s")
            own_s, path_s = pair
        if len(self.further) > MAX_FURTHER:
            raise ValueError(f"at most {MAX_FURTHER} conditions on the way")

    def needed_s(self, own_s: float) -> float:
        """How far the other primitive must have come before this one is at `own_s` of its path (s)."""
        return next((path_s for at_s, path_s in reversed(self.further) if at_s < own_s), self.path_s)


class Partner(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """The part of a second arm in one primitive: both arms start in the same tick, and a stop of one stops the other.

    Two arms that hold one object form a closed chain: one leads, the other complies (impedance)."""

    performer: str
    trajectory: JointTrajectory
    control_law: ControlLaw
    stop_functions: list[StopFunction]
    hand: str | None = None  # as that of a primitive


class Primitive(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="Primitive"):
    """T = (P, M, F, R) for one performer. The constructor refuses F without a goal and a time limit (R82)."""

    id: str  # unique; echoed by every report. "C-7.5@k7f2": see rtc.protocol.primitive_id
    performer: str  # the arm or camera of the subsystem, e.g. RIGHT-ARM
    trajectory: Trajectory
    stop_functions: list[StopFunction]
    control_law: ControlLaw = ControlLaw()
    reporting: Reporting = Reporting()
    start_after: list[StartAfter] = []  # all must be met before it starts; nothing moves until then
    partner: Partner | None = None  # a second arm that moves with it
    hand: str | None = None  # that it was planned with, of an arm with a coupler; empty: none
    space_mm: list[Box] = []  # all that its arms may reach on their paths, for other planners; empty: not known

    def __post_init__(self) -> None:
        for stops in (self.stop_functions, *([self.partner.stop_functions] if self.partner else ())):
            kinds = [type(stop.when) for stop in stops]
            if TimeAbove not in kinds:
                raise ValueError("F is not complete: no TimeAbove")
            if GoalReached not in kinds:
                raise ValueError("F is not complete: no GoalReached")
        if self.partner is not None:
            if self.partner.performer == self.performer:
                raise ValueError(f"{self.performer} cannot be its own partner")
            if not isinstance(self.trajectory, JointTrajectory):
                raise ValueError("only a motion along a path has a partner")
        one_path = self.partner is None and isinstance(self.trajectory, JointTrajectory)
        if self.start_after and not one_path and any(condition.further for condition in self.start_after):
            raise ValueError("only a motion of one arm along a path waits on its way")

    @property
    def performers(self) -> list[str]:
        """All arms that it moves, the leading one first; or all cameras that look."""
        further = self.trajectory.cameras if isinstance(self.trajectory, Look) else ()
        return [self.performer, *([self.partner.performer] if self.partner else ()), *further]

    @property
    def paths(self) -> dict[str, JointTrajectory]:
        """The paths of its arms; empty if no arm leaves its place."""
        if not isinstance(self.trajectory, JointTrajectory):
            return {}
        partner = {self.partner.performer: self.partner.trajectory} if self.partner else {}
        return {self.performer: self.trajectory, **partner}

    @property
    def goal_within_m(self) -> float | None:
        """See `GoalReached`."""
        return next((stop.when.within_m for stop in self.stop_functions if isinstance(stop.when, GoalReached)), None)

    def by_priority(self) -> list[StopFunction]:
        return in_priority(self.stop_functions)
