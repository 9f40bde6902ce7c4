"""The primitive T = (P, M, F, R): the only order to a subsystem (paper, section 4; R60-R67).

    P  trajectory      what to do: positions over time, a command of the hand, or a look of a camera
    M  control_law     how the servo follows it
    F  stop_functions  when to stop, and what to do then; complete, in fixed priority
    R  reporting       what to report beyond the standard end report

A primitive contains frames and numbers only, neither objects, verbs nor sentences (R15). All values are SI.
Joint order is that of the arm's URDF. `tcp` is the tool centre point; tool z points out of the palm, the
fingers close along tool y. A primitive checks itself when it is constructed, so the MCM never gets an incomplete one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Literal

import msgspec

from rtc.protocol.outcomes import PRIORITY, Reflex, StopReason

Vector = list[float]

MOST_TURN_RAD = 1000.0  # maximum turn of a spindle
LONGEST_S = 1e6  # maximum duration; a larger value counts as an error
HEAVIEST_KG, FARTHEST_M, MOST_INERTIA_KG_M2 = 1000.0, 10.0, 1000.0  # a larger load is an error of its unit


class JointTrajectory(msgspec.Struct, frozen=True, kw_only=True, tag="joint-trajectory"):
    """P for an arm: knots, joined by quintic Hermite polynomials. Starts and ends at rest.

    `positions[k][j]` rad at `time_s[k]`; velocities rad/s, accelerations rad/s^2 of the same shape.
    `space`: the space in which the path is a line; the knots are joint values in both cases.
    """

    space: Literal["joint", "task"]
    time_s: Vector
    positions: list[Vector]
    velocities: list[Vector]
    accelerations: list[Vector]

    def __post_init__(self) -> None:
        n = len(self.time_s)
        if n < 2 or self.time_s[0] != 0.0:
            raise ValueError("a trajectory needs two knots or more, the first at time 0")
        if any(b <= a for a, b in zip(self.time_s, self.time_s[1:], strict=False)):
            raise ValueError("time_s must rise from knot to knot")
        dof = len(self.positions[0]) if self.positions else 0
        for name in ("positions", "velocities", "accelerations"):
            rows = getattr(self, name)
            if len(rows) != n or set(map(len, rows)) != {dof}:
                raise ValueError(f"{name} must hold {n} knots of {dof} joints")

    @property
    def duration_s(self) -> float:
        return self.time_s[-1]


class HandMotion(msgspec.Struct, frozen=True, kw_only=True, tag="hand-motion"):
    """P for a parallel gripper: bring the opening to `width_m` at `speed_m_s`, pressing with at most `force_n`.

    Closing on an object continues until both fingers press with `force_n`; this force is then kept.
    """

    width_m: float
    force_n: float
    speed_m_s: float = 0.05


class HoldStill(msgspec.Struct, frozen=True, kw_only=True, tag="hold-still"):
    """P for an arm: keep the position for `duration_s`; None = until it is stopped or its time limit passes."""

    duration_s: float | None = None


class TagGeometry(msgspec.Struct, frozen=True, kw_only=True):
    """An AprilTag of the family 36h11 on a body."""

    id: int
    size_m: float  # edge of the black square
    pose: Vector  # of its centre, in the axes of the body: x to the right and y upwards as one reads it

    def __post_init__(self) -> None:
        if self.id < 0 or not 0.0 < self.size_m <= FARTHEST_M or len(self.pose) != 7:  # false for nan too
            raise ValueError("a tag has a number, a size and a pose of 7 numbers")


class Look(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="look"):
    """P for a camera: locate the body that has these tags. Its pose is in the reports, with its covariance.

    Without a duration the body rests: its pose is fitted to `pictures` in which it is seen. With one it may move: each
    picture gives a pose, until the duration has passed.
    """

    tags: Annotated[list[TagGeometry], msgspec.Meta(min_length=1, max_length=200)]
    believed: Vector  # pose of the body, world frame: only to explain why it is not seen
    pictures: Annotated[int, msgspec.Meta(ge=1, le=100)] = 1
    duration_s: Annotated[float, msgspec.Meta(gt=0, le=LONGEST_S)] | None = None
    every_s: Annotated[float, msgspec.Meta(ge=0.01, le=3600)] = 0.1  # shortest time between two of its pictures
    # Further cameras: each takes as many pictures, and one pose is fitted to all. A camera that does not see the body
    # is left out, if another does.
    cameras: Annotated[list[str], msgspec.Meta(max_length=8)] = []


class SpindleMotion(msgspec.Struct, frozen=True, kw_only=True, tag="spindle-motion"):
    """P for an arm that holds a driver: turn its spindle by `turn_rad` with at most `torque_nm`; the arm keeps its
    position, or presses as its control law says.

    Positive is right-handed about the axis out of the tool: it tightens a right-handed bolt. The goal is the turn; a
    spindle that stalls ends with the time limit, or with a torque above a limit.
    """

    turn_rad: float
    speed_rad_s: float
    torque_nm: float

    def __post_init__(self) -> None:
        if not 0.0 < abs(self.turn_rad) <= MOST_TURN_RAD:  # false for nan too
            raise ValueError(f"a spindle turns by more than 0 and at most {MOST_TURN_RAD:g} rad, not {self.turn_rad}")
        if not (0.0 < self.speed_rad_s < math.inf and 0.0 < self.torque_nm < math.inf):
            raise ValueError("a spindle needs a speed and a torque above 0")


Trajectory = JointTrajectory | HandMotion | HoldStill | SpindleMotion | Look


class Load(msgspec.Struct, frozen=True, kw_only=True):
    """The load in the hand as a rigid body, in tcp axes."""

    mass_kg: float
    com_m: Vector  # centre of mass
    inertia_kg_m2: Vector  # about the centre of mass: xx, yy, zz, xy, xz, yz

    def __post_init__(self) -> None:
        if len(self.com_m) != 3 or len(self.inertia_kg_m2) != 6:
            raise ValueError("a load has a centre of mass of 3 numbers and an inertia of 6")
        if not 0.0 < self.mass_kg <= HEAVIEST_KG:  # false for nan too
            raise ValueError(f"a load of {self.mass_kg} kg: more than 0 and at most {HEAVIEST_KG:g} kg is possible")
        if not all(abs(x) <= FARTHEST_M for x in self.com_m):
            raise ValueError(f"a load has its centre of mass within {FARTHEST_M:g} m of the tcp, not at {self.com_m}")
        xx, yy, zz, xy, xz, yz = self.inertia_kg_m2
        if not all(0.0 <= i <= MOST_INERTIA_KG_M2 for i in (xx, yy, zz)):
            raise ValueError(f"a load has an inertia of 0 to {MOST_INERTIA_KG_M2:g} kg m2 about each axis")
        if not (xy * xy <= 1.001 * xx * yy and xz * xz <= 1.001 * xx * zz and yz * yz <= 1.001 * yy * zz):
            raise ValueError("a load has no inertia whose products exceed its moments")


class ForceProfile(msgspec.Struct, frozen=True, kw_only=True):
    """Force set-points over time: `share[k]` of each at `time_s[k]` since the start of the primitive.

    Linear in between; the last share is kept.
    """

    time_s: Vector
    share: Vector

    def __post_init__(self) -> None:
        if len(self.time_s) < 2 or len(self.time_s) != len(self.share) or self.time_s[0] != 0.0:
            raise ValueError("a force profile needs two times or more, the first 0, and as many shares")
        if not all(a < b <= LONGEST_S for a, b in zip(self.time_s, self.time_s[1:], strict=False)):  # false for nan too
            raise ValueError("the times of a force profile must rise")
        if not all(0.0 <= share <= 1.0 for share in self.share):
            raise ValueError("a share of a force set-point is 0 to 1")


class Compliance(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Figures of a compliant control law, along x y z and about x y z of the selection frame."""

    stiffness: Vector  # N/m three times, N.m/rad three times
    damping: Vector = msgspec.field(default_factory=lambda: [1.0] * 6)  # ratio to critical damping
    frame: Literal["tool", "world"] = "tool"  # axes of the selection frame
    centre: Vector = []  # centre of compliance, origin of the selection frame (m, tool axes); empty: the tcp
    # Force set-points: what the hand exerts on its environment (N, N.m). An axis with a number is force-controlled and
    # has no spring; None leaves it to the spring. Empty: no axis is force-controlled.
    wrench: list[float | None] = []
    profile: ForceProfile | None = None  # of these set-points; None: constant
    most_n: float | None = None  # greatest pull of the spring; None: unlimited
    most_nm: float | None = None
    # Comply until the arm rests: another arm holds the same object and stops too. False: until the primitive ends.
    until_rest: bool = False

    def __post_init__(self) -> None:
        for name, figures in (("stiffness", self.stiffness), ("damping", self.damping)):
            if len(figures) != 6:
                raise ValueError(f"{name} has 6 figures, not {len(figures)}")
        if not all(0.0 <= k < math.inf for k in self.stiffness):  # false for nan too
            raise ValueError(f"a stiffness is 0 or more, not {min(self.stiffness):g}")
        if not all(0.1 <= ratio <= 3.0 for ratio in self.damping):
            raise ValueError("a damping ratio is 0.1 to 3")
        if len(self.centre) not in (0, 3) or not all(abs(x) <= FARTHEST_M for x in self.centre):  # false for nan too
            raise ValueError(f"a centre of compliance has 3 figures of at most {FARTHEST_M:g} m")
        if len(self.wrench) not in (0, 6):
            raise ValueError(f"a wrench has 6 figures, not {len(self.wrench)}")
        if self.profile is not None and not any(self.wrench):
            raise ValueError("a force profile needs a force set-point")
        if not all(force is None or math.isfinite(force) for force in self.wrench):
            raise ValueError("a force set-point is not a finite number")
        for name, most in (("most_n", self.most_n), ("most_nm", self.most_nm)):
            if most is not None and not 0.0 < most < math.inf:
                raise ValueError(f"{name} must be above 0, not {most}")


class ControlLaw(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """M: the registered name of a control law and its gains.

    `position`: computed torque. `impedance`: a spring and damper at the tcp; its figures are in `compliance`, and its
    gains are those of `position`, which holds the arm before and after. `load`: the body in the hand; without it the
    control law would let the arm swing.
    """

    name: str = "position"
    gains: dict[str, float] = {}
    load: Load | None = None
    compliance: Compliance | None = None


# --- F: predicates over the current sample (R66) ----------------------------------------------------
#
# Filters: none, unless a predicate states one. A predicate that is true for a value below a limit counts only after
# the value has been above it in the same primitive: every motion begins without force.


class GoalReached(msgspec.Struct, frozen=True, tag="goal-reached"):
    """The trajectory is complete and the arm has settled; or the hand has its width, or presses with its force; or the
    camera has its pose, or has followed the body for the duration."""


class TimeAbove(msgspec.Struct, frozen=True, tag="time-above"):
    limit_s: float  # since the start of the primitive, in the time of the simulation, without pauses

    def __post_init__(self) -> None:
        if not 0.0 <= self.limit_s <= LONGEST_S:  # false for nan too
            raise ValueError(f"a time limit of {self.limit_s} s: 0 to {LONGEST_S:g} s is possible")


class ForceAbove(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="force-above"):
    """Wrist force beyond a limit: its magnitude, or its part along `axis` (unit vector, tool axes)."""

    limit_n: float
    axis: Vector | None = None


class TorqueAbove(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="torque-above"):
    limit_nm: float
    axis: Vector | None = None


class ForceBelow(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="force-below"):
    """Wrist force below a limit for `for_s`, after it has been above `armed_n` (default: the limit)."""

    limit_n: float
    armed_n: float | None = None
    axis: Vector | None = None  # as in ForceAbove; then the magnitude of that part
    for_s: float = 0.02


class TorqueBelow(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="torque-below"):
    limit_nm: float
    axis: Vector | None = None
    for_s: float = 0.02


class NoProgress(msgspec.Struct, frozen=True, kw_only=True, tag="no-progress"):
    """The tcp is farther than this behind its command, while the wrist force is above a limit: a compliant arm jams."""

    behind_m: float
    force_n: float


class SpeedAbove(msgspec.Struct, frozen=True, tag="speed-above"):
    """A measured joint speed exceeds `ratio` times its limit. The MCM adds one with its own ratio to each primitive."""

    ratio: float


class FollowingErrorAbove(msgspec.Struct, frozen=True, tag="following-error-above"):
    """A measured joint is farther than this from its command. The MCM adds one with its own limit to each primitive."""

    limit_rad: float


class JointMarginBelow(msgspec.Struct, frozen=True, tag="joint-margin-below"):
    margin_rad: float  # of the nearest joint limit, moving towards it


class ArmTouch(msgspec.Struct, frozen=True, tag="arm-touch"):
    """The arm or its hand is in contact with another arm. The MCM adds one to each primitive."""


class BodyTouch(msgspec.Struct, frozen=True, tag="body-touch"):
    """A link of the arm (not palm or fingers, which may touch) is in contact with anything."""


class GripForceBelow(msgspec.Struct, frozen=True, omit_defaults=True, tag="grip-force-below"):
    limit_n: float
    once_above: bool = False  # for a hand that closes: counts after it has been above, and then for 20 ms


class GripForceAbove(msgspec.Struct, frozen=True, tag="grip-force-above"):
    limit_n: float  # of the finger that presses more


class HandWidthBelow(msgspec.Struct, frozen=True, tag="hand-width-below"):
    limit_m: float  # less than the width of the held object: a narrower hand holds nothing


class TcpNear(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="tcp-near"):
    point: Vector  # world frame, m
    distance_m: float
    axis: Vector | None = None  # unit vector, world: only the distance along it counts


class TcpFar(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="tcp-far"):
    point: Vector  # as in TcpNear
    distance_m: float
    axis: Vector | None = None


class TcpSpeedAbove(msgspec.Struct, frozen=True, tag="tcp-speed-above"):
    limit_m_s: float  # mean over the last 19 ms


class TcpOutside(msgspec.Struct, frozen=True, kw_only=True, tag="tcp-outside"):
    """The tcp is outside a box."""

    centre: Vector  # pose, world: x y z qx qy qz qw
    size_m: Vector


class TcpInside(msgspec.Struct, frozen=True, kw_only=True, tag="tcp-inside"):
    centre: Vector  # as in TcpOutside
    size_m: Vector


class UnseenAbove(msgspec.Struct, frozen=True, tag="unseen-above"):
    limit_s: float  # a camera has not seen the body in any of its pictures over this time

    def __post_init__(self) -> None:
        if not 0.0 < self.limit_s <= LONGEST_S:  # false for nan too
            raise ValueError(f"a limit of {self.limit_s} s without a sight: more than 0, at most {LONGEST_S:g} s")


class TcpTurned(msgspec.Struct, frozen=True, kw_only=True, tag="tcp-turned"):
    """The attitude of the tcp differs from the given one by more than `limit_rad`."""

    attitude: Vector  # quaternion x y z w, world
    limit_rad: float


class TurnAbove(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="turn-above"):
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


class JointTurnAbove(msgspec.Struct, frozen=True, kw_only=True, tag="joint-turn-above"):
    """A joint has turned, either way, by more than this since the start of the primitive."""

    joint: int  # index, from the base
    limit_rad: float


class ClearanceBelow(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="clearance-below"):
    """A link of the arm, the palm or a finger is nearer than this to another body, without what the fingers hold.

    A body that is that near at the start counts once it has been farther. Filter: measured every 20 ms.
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


class StopFunction(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One condition, the reason it gives, and the reflex it triggers."""

    reason: StopReason
    when: Predicate
    reflex: Reflex = Reflex.STOP
    back_off_m: float = 0.0  # for BACK_OFF: back along the path


class ReportCondition(msgspec.Struct, frozen=True, kw_only=True):
    """A condition that is reported and does not stop: once, at the first moment in which it is true."""

    n: int  # number of the condition in the sentence, from 0; several predicates may share it
    when: Predicate

    def __post_init__(self) -> None:
        if isinstance(self.when, GoalReached):
            raise ValueError("the goal is in the end report")


class Reporting(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """R: additions to the standard end report, which always has joints, wrench and reason (R65)."""

    every_s: float | None = None  # progress reports at this period
    when: list[ReportCondition] = []  # at most one report for each `n`


class StartAfter(msgspec.Struct, frozen=True, kw_only=True):
    """A start condition: a primitive of another arm has left the space that this one needs.

    It is met when that primitive has executed its trajectory up to `path_s`, also if it was stopped later than that. It
    cannot be met if that primitive ended earlier, or `within_s` has passed; then nothing starts.
    """

    primitive: str
    path_s: float  # time along its trajectory
    within_s: float  # maximum wait, in the time of the simulation

    def __post_init__(self) -> None:
        if not (0.0 <= self.path_s <= LONGEST_S and 0.0 < self.within_s <= LONGEST_S):  # false for nan too
            raise ValueError(f"a start condition has times of 0 to {LONGEST_S:g} s")


class Partner(msgspec.Struct, frozen=True, kw_only=True):
    """The part of a second arm in one primitive: both arms start in the same tick, and a stop of one stops the other.

    Two arms that hold one object form a closed chain: one leads, the other complies (impedance)."""

    performer: str
    trajectory: JointTrajectory
    control_law: ControlLaw
    stop_functions: list[StopFunction]


class Primitive(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="Primitive"):
    """T = (P, M, F, R) for one performer. The constructor refuses F without a goal and a time limit (R82)."""

    id: str  # unique; echoed by every report. "C-7.5@k7f2": see rtc.protocol.primitive_id
    performer: str  # the arm or camera of the subsystem, e.g. RIGHT-ARM
    trajectory: Trajectory
    stop_functions: list[StopFunction]
    control_law: ControlLaw = ControlLaw()
    reporting: Reporting = Reporting()
    start_after: list[StartAfter] = []  # all must be met before it starts; nothing moves until then
    partner: Partner | None = None  # a second arm that moves with it

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

    def by_priority(self) -> list[StopFunction]:
        return in_priority(self.stop_functions)


def in_priority(stops: Iterable[StopFunction]) -> list[StopFunction]:
    """F in the fixed order in which it is evaluated every tick; the first that is true wins (A21)."""
    return sorted(stops, key=lambda stop: PRIORITY[stop.reason])
