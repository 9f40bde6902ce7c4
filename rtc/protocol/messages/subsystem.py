"""Broker <-> subsystems: primitives and their reports, halts; and telemetry for subscribers."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec

from rtc.protocol.messages.client import Declined
from rtc.protocol.messages.shared import Heartbeat, Hello, HelloWanted, Message, Name, PictureTime, UnreadableMessages
from rtc.protocol.outcomes import Measured, Reflex, Sighting, StopReason
from rtc.protocol.primitive import Primitive


class SubsystemHello(Hello, frozen=True, kw_only=True):
    """A subsystem is ready. `outstanding`: primitives it executes or whose report is not acknowledged."""

    name: Name  # MCM, S&P
    pid: int
    performers: Annotated[list[Name], msgspec.Meta(max_length=10_000)]  # LEFT-ARM, RIGHT-ARM
    # Those that take several primitives at once and serve them in turn: cameras.
    queues: Annotated[list[Name], msgspec.Meta(max_length=10_000)] = []
    outstanding: Annotated[list[Name], msgspec.Meta(max_length=10_000)] = []
    at_rest: bool = True
    paused: Annotated[list[Name], msgspec.Meta(max_length=10_000)] = []  # primitives that it was ordered to pause


class Execute(Message, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Execute a primitive. A repeated one is executed once. One that the broker sent before it knew of a halt is not
    begun after that halt."""

    primitive: Primitive
    pid: int = 0  # of the process it is for, as in its hello; another one ignores it; 0 = any


class HaltOrder(Message, frozen=True, kw_only=True):
    """Stop now. `scope`: ALL, a performer, or a command number, which stops the primitives that begin with it.

    It is obeyed whenever it is received, also if its name was used before. From a subsystem to the broker: a halt that
    bypassed the broker. Nothing in its scope begins until the broker has answered with the same order; the subsystem
    repeats it with every hello until then."""

    halt: Name
    scope: Name = "ALL"
    called_at_s: float = 0.0  # when the operator called
    call: Name = ""  # the sender's number of this order; answers repeat it
    # From a subsystem only: when it received the halt; sentences sent later go on. 0: unknown.
    received_at_s: float = 0.0


class SetPaused(Message, frozen=True, kw_only=True):
    """Pause a primitive on its path, or let it go on. Repeating it changes nothing; one that has ended ignores it.

    F is checked during a pause. A time limit does not count from the order to pause until the order to go on."""

    primitive: Name
    paused: bool


class OperatorAnswer(Message, frozen=True, kw_only=True):
    """DONE or CANNOT of the operator who performs a primitive. The answer is its end report, or AnswerRefused.
    Repeating it changes nothing."""

    primitive: Name
    done: bool
    why: str = ""  # of CANNOT


class AnswerRefused(Message, frozen=True, kw_only=True):
    """The measurements do not prove a DONE; the primitive goes on."""

    primitive: Name
    message: str


class Injected(Message, frozen=True, kw_only=True):
    """The faults that are injected in a simulated subsystem, for `rtc status`; after each change and each hello."""

    active: Annotated[list[Name], msgspec.Meta(max_length=1000)] = []


class Strayed(Message, frozen=True, kw_only=True):
    """The arms that have moved without a primitive, with what happened, until each begins its next primitive.

    They are braked. After each change, and with each hello if there are any."""

    arms: Annotated[dict[Name, Name], msgspec.Meta(max_length=1000)]


class ReportAck(Message, frozen=True, kw_only=True):
    """The broker has journalled the end report of this primitive; the subsystem may forget it."""

    primitive: str


class Started(Message, frozen=True, kw_only=True):
    primitive: str
    at_s: float


class PauseChanged(Message, frozen=True, kw_only=True):
    """A primitive has come to rest on its path, or has gone on from there."""

    primitive: str
    at_s: float
    paused: bool
    done: float = 0.0  # part of the duration of its trajectory, 0 to 1


class ProgressReport(Message, frozen=True, kw_only=True):
    """A report during a motion or a look: at the period requested in R, or because a condition of R is true."""

    primitive: str
    at_s: float
    reading: Measured  # the items of R
    condition: int | None = None  # number of the condition; None: a periodic report
    measured: float | None = None  # what the condition compares
    limit: float | None = None


class EndReport(Message, frozen=True, kw_only=True):
    """The one end report of a primitive: what, where, why (R65). Repeated until it is acknowledged.

    Joints, poses, wrenches and the hand are those of an arm; of a camera they are empty, and it has a sighting."""

    primitive: Name
    performer: Name
    reason: StopReason
    at_s: float
    duration_s: float  # in the time of the simulation, pauses included
    paused_s: float = 0.0  # of it
    moved_s: float | None = None  # of it, the time in which the arm moved; None: all of it but the pauses
    joints: list[float] = []  # rad, after coming to rest; m for those of `slides`
    slides: list[int] = []  # numbers of the joints that slide
    tcp_pose: list[float] = []  # at rest
    wrench: list[float] = []  # at rest
    hand: str | None = None  # in the coupler, as it reads it; empty: none; None: the arm has no coupler
    hand_width_m: float = 0.0
    hand_force_n: float = 0.0  # pressed by the fingers, the smaller of the two
    peak_force_n: float = 0.0  # while moving
    peak_torque_nm: float = 0.0
    trip_pose: list[float] | None = None  # of the tcp, in the tick that tripped
    trip_wrench: list[float] | None = None
    measured: float | None = None  # the value that tripped
    limit: float | None = None  # the limit it exceeded
    message: str = ""  # for REFUSED: why; for COLLISION: the bodies' link names
    turned_rad: float | None = None  # by the spindle of a held driver
    reflex: Reflex = Reflex.STOP  # what was done after the stop: BACK_OFF, RELEASE
    facts: dict[str, Any] = {}  # stated, by key (MACS-OLD.frame), SI; an analyzer writes them
    partner: EndReport | None = None  # of the second arm, if the primitive has one
    sighting: Sighting | None = None  # of a camera; None: the body was not seen
    reading: Measured | None = None  # the items of R; None: the sentence requests none
    pictures: dict[Name, PictureTime] = {}  # of a camera: of all cameras of its subsystem that have given one


class HaltStarted(Message, frozen=True, kw_only=True):
    """The first decelerating tick of a halt (the figure `rtc halt` prints)."""

    halt: str
    subsystem: str
    received_at_s: float
    decelerating_at_s: float
    moving: list[str]  # performers that were in motion
    call: str = ""  # of the order that this answers


class HaltAtRest(Message, frozen=True, kw_only=True):
    """All performers in the scope of the halt are at rest (or not: `at_rest`)."""

    halt: str
    subsystem: str
    at_s: float
    at_rest: bool
    performers: list[str]
    call: str = ""  # of the order that this answers
    # From the receipt of the halt until then, by the subsystem's own clock: of a simulator simulated time.
    own_s: float = 0.0


# --- subsystem -> subscribers (PUB) ---


class ArmSample(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    joints: list[float]
    velocities: list[float]
    wrench: list[float]
    tcp_pose: list[float]
    hand_width_m: float
    primitive: str  # being executed; empty = holding
    operation: TeleopState | None = None  # the operator moves it


class TeleopState(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What the operator may do with an arm, and does. It is a grant: it ends with the primitive of the sample."""

    request: str  # what the operator is asked to do
    centre: list[float] = []  # m, world: the ball that the tcp may not leave; empty: anywhere
    radius_m: float | None = None
    off_m: float | None = None  # of the tcp from the centre
    done_m: float | None = None  # DONE needs it to be at most this
    hand: bool = False  # the operator moves the fingers too
    spindle: bool = False
    operator: str = ""  # who moves it now
    cut: str = ""  # why it moves less than wanted
    towards: list[float] = []  # m and rad, world: the way in the operator's axes that a path waits for; empty: none


class Operate(Message, frozen=True, kw_only=True):
    """One moment of an operator's hand, to the `operate` socket of a subsystem, 20 to 100 per second. Each is answered.

    While the latest one has `hold`, the tcp follows its twist. The arm stops when none has arrived for 60 ms."""

    primitive: Name  # of the grant; one of an earlier grant does nothing
    operator: Name  # who sends it, for people
    # `at_s` of the latest answer or telemetry of this subsystem. One that has seen nothing for 200 ms does nothing.
    seen_at_s: float
    hold: bool = False  # the deadman: false stops the arm, its hand and spindle, and another operator may take it
    # m/s, rad/s of the tcp
    twist: Annotated[list[float], msgspec.Meta(min_length=6, max_length=6)] = msgspec.field(
        default_factory=lambda: [0.0] * 6
    )
    frame: Literal["tool", "world"] = "world"  # axes of the twist
    hand: Literal["", "open", "close"] = ""
    turn: Annotated[float, msgspec.Meta(ge=-1.0, le=1.0)] = 0.0  # share of the spindle's speed; positive tightens


class OperateReply(Message, frozen=True, kw_only=True):
    """What a subsystem has done with an `Operate`. An empty primitive asks for the time alone."""

    primitive: Name
    at_s: float
    refused: str = ""  # why it does nothing; empty: it counts
    cut: str = ""  # why the arm moves less than it wants


class Telemetry(Message, frozen=True, kw_only=True):
    subsystem: str
    at_s: float
    sim_s: float
    late_ticks: int  # since the start
    ticks: int
    arms: dict[str, ArmSample]


SubsystemToBroker = (
    SubsystemHello
    | Heartbeat
    | Started
    | PauseChanged
    | ProgressReport
    | EndReport
    | HaltStarted
    | HaltAtRest
    | HaltOrder
    | Injected
    | Strayed
    | AnswerRefused
    | UnreadableMessages
)
BrokerToSubsystem = (
    Execute | SetPaused | OperatorAnswer | HaltOrder | ReportAck | HelloWanted | Declined
)  # Declined: its hello is refused
ToHalt = HaltOrder  # on the broker's halt socket and the MCM's estop socket
FromHalt = HaltStarted | HaltAtRest | Declined
