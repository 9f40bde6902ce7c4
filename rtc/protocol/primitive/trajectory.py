"""P of a primitive: positions over time, a motion of the hand, a turn of a spindle, a look, or an operator's twists."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import msgspec

from rtc.protocol.knots import Knots
from rtc.protocol.primitive.limits import FARTHEST_M, MAX_S, Vector
from rtc.protocol.strict import Strict

MAX_TURN_RAD = 1000.0  # maximum turn of a spindle


class JointTrajectory(Strict, frozen=True, kw_only=True, tag="joint-trajectory"):
    """P for an arm: knots, joined by quintic Hermite polynomials. Starts and ends at rest.

    `positions[k][j]` rad at `time_s[k]`; velocities rad/s, accelerations rad/s^2 of the same shape. The constructor
    takes lists of rows too.
    `space`: the space in which the path is a line; the knots are joint values in both cases.
    """

    space: Literal["joint", "task"]
    time_s: Vector
    positions: Knots
    velocities: Knots
    accelerations: Knots

    def __post_init__(self) -> None:
        n = len(self.time_s)
        if n < 2 or self.time_s[0] != 0.0:
            raise ValueError("a trajectory needs two knots or more, the first at time 0")
        if any(b <= a for a, b in zip(self.time_s, self.time_s[1:], strict=False)):
            raise ValueError("time_s must rise from knot to knot")
        for name in ("positions", "velocities", "accelerations"):
            rows = getattr(self, name)
            if not isinstance(rows, Knots):
                rows = Knots.of(rows)
                msgspec.structs.force_setattr(self, name, rows)
                if len(rows) != n:
                    raise ValueError(f"{name} must hold {n} knots")
            if rows.in_rows(n).columns != self.positions.columns:
                raise ValueError(f"{name} must hold {n} knots of {self.positions.columns} joints")

    @property
    def duration_s(self) -> float:
        return self.time_s[-1]


class HandMotion(Strict, frozen=True, kw_only=True, tag="hand-motion"):
    """P for a parallel gripper: bring the opening to `width_m` at `speed_m_s`, pressing with at most `force_n`.

    Closing on an object continues until both fingers press with `force_n`; this force is then kept.
    """

    width_m: float
    force_n: float
    speed_m_s: float = 0.05


class HoldStill(Strict, frozen=True, kw_only=True, tag="hold-still"):
    """P for an arm: keep the position for `duration_s`; None = until it is stopped or its time limit passes."""

    duration_s: float | None = None


class TagGeometry(Strict, frozen=True, kw_only=True):
    """An AprilTag of the family 36h11 on a body."""

    id: int
    size_m: float  # edge of the black square
    pose: Vector  # of its centre, in the axes of the body: x to the right and y upwards as one reads it

    def __post_init__(self) -> None:
        if self.id < 0 or not 0.0 < self.size_m <= FARTHEST_M or len(self.pose) != 7:  # false for nan too
            raise ValueError("a tag has a number, a size and a pose of 7 numbers")


class Look(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="look"):
    """P for a camera: locate the body that has these tags. Its pose is in the reports, with its covariance.

    Without a duration the body rests: its pose is fitted to `pictures` in which it is seen. With one it may move: each
    picture gives a pose, until the duration has passed.
    """

    tags: Annotated[list[TagGeometry], msgspec.Meta(min_length=1, max_length=200)]
    believed: Vector  # pose of the body, world frame: only to explain why it is not seen
    pictures: Annotated[int, msgspec.Meta(ge=1, le=100)] = 1
    duration_s: Annotated[float, msgspec.Meta(gt=0, le=MAX_S)] | None = None
    every_s: Annotated[float, msgspec.Meta(ge=0.01, le=3600)] = 0.1  # shortest time between two of its pictures
    # Further cameras: each takes as many pictures, and one pose is fitted to all. A camera that does not see the body
    # is left out, if another does.
    cameras: Annotated[list[str], msgspec.Meta(max_length=8)] = []


class SpindleMotion(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="spindle-motion"):
    """P for an arm that holds a driver: turn its spindle by `turn_rad` with at most `torque_nm`. The arm keeps its
    position, or presses as its control law requires.

    Positive is right-handed about the axis out of the tool: it tightens a right-handed bolt. The goal is the turn; a
    spindle that stalls ends with the time limit, or with a torque above a limit.
    """

    turn_rad: float
    speed_rad_s: float
    torque_nm: float
    retreat: JointTrajectory | None = None  # a line of the arm that ends at the bolt: BACK_OFF goes back along it

    def __post_init__(self) -> None:
        if not 0.0 < abs(self.turn_rad) <= MAX_TURN_RAD:  # false for nan too
            raise ValueError(f"a spindle turns by more than 0 and at most {MAX_TURN_RAD:g} rad, not {self.turn_rad}")
        if not (0.0 < self.speed_rad_s < math.inf and 0.0 < self.torque_nm < math.inf):
            raise ValueError("a spindle needs a speed and a torque above 0")


class Coupling(Strict, frozen=True, kw_only=True, tag="coupling"):
    """P for an arm with a coupler: lock the hand that is before it, or let go of the one that it has. It rests.

    A hand that is not where the coupler reaches it is not locked: the primitive ends with NO_CONTACT.
    """

    hand: Annotated[str, msgspec.Meta(max_length=100)]  # its identity, as the coupler reads it; empty: let go


class TeleopMotion(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="operated"):
    """P for an arm that the operator moves: twists (`messages.Operate`) instead of positions over time.

    It ends with DONE, if the measurements prove it, or with CANNOT. The tcp may not leave the ball about
    `centre`; one that is outside at the start may not go farther away.
    """

    request: str  # what the operator is asked to do, in words for a person; no process reads it
    speed_m_s: float  # maximum speeds of the tcp
    turn_rad_s: float
    centre: Vector = []  # m, world; empty: the arm may move anywhere
    radius_m: float = math.inf  # of the ball
    hand: bool = False  # the operator moves the fingers too
    grip_n: float = 0.0  # with which they close
    spindle: bool = False  # and the spindle of the driver in the hand
    spindle_rad_s: float = 0.0
    spindle_nm: float = 0.0
    done_m: float | None = None  # DONE needs the tcp within this distance of the centre
    done_grip_n: float | None = None  # DONE needs both fingers to press with this
    turn_rad: float = 0.0  # turn of the spindle that is asked for: it turns no farther, and DONE needs it
    # A shared motion has a path of the program. `operator_axes` are those of the twist that the operator has (0 to 2
    # along, 3 to 5 about x, y, z of the tool). In the others the tcp follows the path while the deadman is held; DONE
    # needs its end.
    along: JointTrajectory | None = None
    operator_axes: Annotated[list[Annotated[int, msgspec.Meta(ge=0, le=5)]], msgspec.Meta(max_length=6)] = []

    def __post_init__(self) -> None:
        if not (0.0 < self.speed_m_s < math.inf and 0.0 < self.turn_rad_s < math.inf):
            raise ValueError("an operated arm needs maximum speeds above 0")
        if len(self.centre) not in (0, 3) or not all(abs(x) <= FARTHEST_M for x in self.centre):  # false for nan too
            raise ValueError("the centre of an operated arm has 3 numbers, or none")
        if not self.radius_m > 0.0:
            raise ValueError("the radius of an operated arm must be above 0")
        if self.done_m is not None and not (self.centre or self.along):
            raise ValueError("a distance for DONE needs a centre or a path")
        if self.hand and not 0.0 < self.grip_n < math.inf:
            raise ValueError("a hand of the operator needs a grip force")
        figures = (self.spindle_rad_s, self.spindle_nm, abs(self.turn_rad))
        if self.spindle and not all(0.0 < figure < math.inf for figure in figures):
            raise ValueError("a spindle of the operator needs a speed, a torque and a turn")
        if (self.along is None) != (not self.operator_axes):
            raise ValueError("a shared motion needs both a path and the axes of the operator")


Trajectory = JointTrajectory | HandMotion | HoldStill | SpindleMotion | Coupling | Look | TeleopMotion
