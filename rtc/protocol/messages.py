"""All messages between processes, in the order of a command's journey: read this file first.

Every message is a frozen struct, on the wire a MessagePack map whose key "type" holds the name of the class (see
`rtc.protocol.wire`, the only module that encodes). Unknown keys are ignored and missing keys take their defaults, so
that different versions can communicate (R42).

Times that end in `_at_s` are CLOCK_MONOTONIC seconds of the machine they were taken on, comparable between
the processes of one host; `_s` is a duration. Poses are [x y z qx qy qz qw] (m, unit quaternion), in world
axes unless a `frame` states another. A wrench is [Fx Fy Fz Tx Ty Tz] (N, N.m) that the environment exerts on
the hand, in tool axes at the tcp. Names are upper case.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any, Literal, NotRequired, TypedDict

import msgspec

from rtc.language.record import Condition, ParsedCommand, ReflexItem
from rtc.protocol.faults import AnyFault
from rtc.protocol.outcomes import Measured, Outcome, Reflex, Refusal, Sighting, StopReason
from rtc.protocol.primitive import Primitive


class Message(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag=True, gc=False):
    """Base of all messages. They contain no reference cycles, so the garbage collector does not track them."""


# Limits of what a peer chooses and the receiver keeps; a message above them is not decoded.
NODES = 1 << 16  # number of addresses of workers
PROGRAM_BYTES = 128 << 10  # maximum size of a program file; the longest default program has 7 kB
Name = Annotated[str, msgspec.Meta(max_length=200)]  # characters


# --- 1. client -> broker (front) -----------------------------------------------------------------


class CommandText(Message, frozen=True, kw_only=True):
    """A sentence. The same (client, request) sent twice is one command: a client may repeat it after a reconnect."""

    request: Name  # chosen by the client, unique for it
    text: str
    source: Literal["operator", "aip"] = "operator"  # appears in records only (R133)
    progress: bool = True  # send ProgressNotes too, not only the end
    halt_if_lost: bool = False  # halt this command if the client is lost; the client sends Heartbeat every second
    # A sentence sent before a HALT ALL does not start after it; 0 = unknown.
    sent_at_s: Annotated[float, msgspec.Meta(ge=0)] = 0.0
    cluster: Name = ""  # the run it is for, as in Welcome; another run declines it; empty = any
    known_as: Name = ""  # C-n, if it is sent again after it was accepted


class StatusQuery(Message, frozen=True, kw_only=True):
    request: Name


class TraceQuery(Message, frozen=True, kw_only=True):
    request: Name
    command: Name  # C-n


class ProgramText(Message, frozen=True, kw_only=True):
    """LOAD: replace the program of a kind of worker by this document, or merge it into it."""

    request: Name
    kind: WorkerKind
    name: Name  # of the file, for messages
    body: Annotated[bytes, msgspec.Meta(max_length=PROGRAM_BYTES)]  # YAML
    reset: bool = False  # restore the default program of this kind; `body` is ignored
    cluster: Name = ""  # as in CommandText


class ProgramQuery(Message, frozen=True, kw_only=True):
    """Query the program of a kind of worker, or the cell. The answer is ProgramReply."""

    request: Name
    kind: WorkerKind | None = None  # None: the document of the cell


class ClientHello(Message, frozen=True, kw_only=True):
    """First message of a client; its name `client` survives reconnects. The answer is Welcome."""

    client: Name
    at_s: float = 0.0  # the client's clock, from which a gateway computes the offset; 0 = unknown
    arrays: bool = False  # it also reads arrays of messages; else each message travels alone


class Shutdown(Message, frozen=True, kw_only=True):
    """End in order: the cluster (from a client) or a retiring worker. From the supervisor to the broker: halt
    everything, accept no more commands, and answer AllEnded."""

    request: Name = ""
    why: str = ""  # to a worker that the gateway rejects: the reason


# --- broker -> client ---------------------------------------------------------------------------------


class Welcome(Message, frozen=True, kw_only=True):
    cluster: str  # the run's id
    pid: int
    arrays: bool = False  # the broker reads arrays of messages too


class Accepted(Message, frozen=True, kw_only=True):
    request: str
    command: str  # C-n


class Declined(Message, frozen=True, kw_only=True):
    """The request was not accepted (not a command's outcome): unknown command, queue full, bad message."""

    request: str
    refusal: Refusal


class Phase(StrEnum):
    """Phase of a command. ENDED is final; HALTING and CLOSING lead only to ENDED."""

    PARSING = "parsing"
    ELABORATING = "elaborating"
    HELD = "held"  # waits for its resources
    WAITING = "waiting"  # waits until another arm leaves the space that it needs
    BINDING = "binding"
    EXECUTING = "executing"
    ANALYZING = "analyzing"
    PAUSED = "paused"  # between two steps; in replies to queries also on the path of a motion
    HALTING = "halting"  # halted; waits until rest is confirmed
    CLOSING = "closing"  # a last analysis, whose advice is ignored; facts about what was touched become suspect
    ENDED = "ended"


class ProgressNote(Message, frozen=True, kw_only=True):
    """One event in the journey of a command; also one line of a trace."""

    seq: int  # number in the broker's event stream; 0: a report of EVERY or WHEN, outside that stream
    at_s: float
    command: str
    phase: Phase  # the phase it is in now
    step: str = ""  # "5 of 9: feel GP1"
    node: str = ""  # process that did the work that just ended: "binder@2", "MCM"
    took_s: float = 0.0  # duration of that work, from dispatch to answer
    note: str = ""  # its result, in words
    expected_s: float = 0.0  # planned duration of the current step; 0 = unknown
    measured: Measured | None = None  # what REPORT requests
    warning: bool = False  # needs a person's attention although the command continues


class CommandEnded(Message, frozen=True, kw_only=True):
    seq: int
    at_s: float
    command: str
    request: str
    text: str
    outcome: Outcome
    took_s: float


class RequestRefused(Message, frozen=True, kw_only=True):
    """Published for observers: a request that never became a command. Above a rate they are only counted."""

    at_s: float
    request: str
    refusal: Refusal
    text: str = ""  # the sentence, where it is known


class HaltRequested(Message, frozen=True, kw_only=True):
    """Published for observers: a halt that is not a sentence, also one of arms at rest. Once per halt."""

    at_s: float
    halt: str
    scope: str
    called_at_s: float = 0.0  # when the operator called; 0: unknown
    refused: str = ""  # why nothing was halted: the scope is unknown


class StatusReply(Message, frozen=True, kw_only=True):
    request: str
    status: dict[str, Any]  # see docs/protocol.md; plain JSON types


class CommandRecord(Message, frozen=True, kw_only=True):
    """The whole record of a command, live or archived."""

    command: str
    text: str
    source: str
    request: str
    accepted_at_s: float
    phase: Phase
    notes: list[ProgressNote] = []
    outcome: Outcome | None = None
    ended_at_s: float | None = None
    reports: list[ProgressNote] = []  # the latest reports of EVERY and WHEN; the broker that sent them keeps some
    reports_older: int = 0  # number of those before them


class TraceReply(Message, frozen=True, kw_only=True):
    request: str
    record: CommandRecord


class ProgramLoaded(Message, frozen=True, kw_only=True):
    request: str
    kind: WorkerKind
    digest: str  # of the whole program
    changes: list[str] = []  # in words, one for each changed item; empty: nothing changed


class ProgramReply(Message, frozen=True, kw_only=True):
    request: str
    kind: WorkerKind | None = None  # None: the cell
    digest: str
    body: bytes  # the whole program in its canonical form, or the cell: JSON; for the parser a grammar


# --- 2. broker <-> workers ----------------------------------------------------------------------------


class WorkerKind(StrEnum):
    """The four kinds of worker; the position of a kind gives the two low bits of a node's cube address."""

    PARSER = "parser"
    ELABORATOR = "elaborator"
    BINDER = "binder"
    ANALYZER = "analyzer"


class Lease(msgspec.Struct, frozen=True, kw_only=True):
    """Permission to write these locations, for this job. The broker signs it, the world database checks it (A25)."""

    job: str
    locations: list[str]
    signature: bytes


class Job(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """One stateless job. Its bytes and the world version it read suffice to repeat it (R10)."""

    id: str  # "C-7/12": command and a number
    attempt: int  # from 1; an answer to an older attempt is stale
    program: str  # digest
    cell: str = ""  # digest of the cell; empty = not needed by this kind
    input: msgspec.Raw  # ParserInput | ElaboratorInput | BinderInput | AnalyzerInput
    lease: Lease | None = None  # analyzers only
    doubt: str = ""  # not empty: only make the leased facts suspect, for this reason


class JobBatch(Message, frozen=True, kw_only=True):
    jobs: list[Job]


class Drop(Message, frozen=True, kw_only=True):
    """Cancel these jobs, as far as they have not begun."""

    jobs: list[str]


class ProgramBody(Message, frozen=True, kw_only=True):
    digest: str
    body: bytes | None  # None: unknown program


class WorkerHello(Message, frozen=True, kw_only=True):
    """A worker is ready. `node` is its address in the cube, `name` "binder@2".

    With an `instance` the gateway assigns the address and answers WorkerAddress; `node` is then the address that the
    worker had before, or None."""

    name: Name
    node: Annotated[int, msgspec.Meta(ge=0, lt=NODES)] | None
    kind: WorkerKind
    pid: int
    instance: Name = ""  # random name of this process, the same in every hello


class WorkerAddress(Message, frozen=True, kw_only=True):
    """The address that the gateway has assigned to a worker with an `instance`."""

    name: Name
    node: Annotated[int, msgspec.Meta(ge=0, lt=NODES)]


class Heartbeat(Message, frozen=True, kw_only=True):
    """Sign of life, with the current job, if any. From a worker, a subsystem, or a client with `halt_if_lost`.

    The broker returns that of a registered worker if it has a time."""

    name: Name
    job: Name = ""
    at_s: float = 0.0  # clock of the worker; 0 = no answer wanted
    # From a worker: how long the answer to an earlier one took; None = not measured again.
    round_trip_s: Annotated[float, msgspec.Meta(ge=0, le=3600)] | None = None


class JobDone(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="done", gc=False):
    id: str
    attempt: int
    product: msgspec.Raw  # ParsedCommand | Script | BoundStep | Assessment
    took_s: float = 0.0
    world_version: int = 0  # version of the world that the job has read; 0 = none


class JobRefused(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="refused"):
    id: str
    attempt: int
    refusal: Refusal
    took_s: float = 0.0
    world_version: int = 0


class JobCrashed(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="crashed"):
    """The worker function raised an exception: a bug, with its evidence. Counts like a death of the worker."""

    id: str
    attempt: int
    evidence: str  # traceback, cut to some kB


JobResult = JobDone | JobRefused | JobCrashed


class Dropped(Message, frozen=True, kw_only=True):
    """Number of unreadable messages by socket since the start of the process, for `rtc status`. Sent now and then by
    the processes that have sockets of their own (MCM, world database)."""

    counts: Annotated[dict[Name, int], msgspec.Meta(max_length=10)]


class ResultBatch(Message, frozen=True, kw_only=True):
    name: str  # of the worker
    results: Annotated[list[JobResult], msgspec.Meta(max_length=1000)]


class WorkerGone(Message, frozen=True, kw_only=True):
    """A worker on another machine is gone. From the gateway if its connection is lost, or from the worker."""

    name: Name
    in_order: bool = False  # it ended as ordered: none of its jobs is the cause


class ProgramWanted(Message, frozen=True, kw_only=True):
    digest: str


# --- 3. what jobs carry -------------------------------------------------------------------------------


class Binding(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A named parameter of a script: joints, a pose (in the axes of the object or seat `frame`, if one is named), or a
    number. Exactly one of `joints`, `pose` and `number` is set."""

    joints: list[float] | None = None  # rad
    pose: list[float] | None = None  # of the tcp
    frame: str | None = None  # the object or seat whose axes the pose is in; None = world
    grasp: list[float] | None = None  # pose of the held object in the hand that this pose was made for
    number: float | None = None


class Way(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A way of an arm that an elaborator has found free. A binder may use it if its own planning request has the same
    digest; otherwise it plans anew (`workers.planning.motion.handed`)."""

    asked: bytes  # digest of the planning request: joints of all arms, goal, scene, rules
    space: Literal["joint", "task"]
    s: list[float]  # parameter of each knot; rises from 0
    knots: list[list[float]]  # rad
    radii: list[float] = []  # of the rounded corners at the inner knots, in the unit of s
    notes: list[str] = []  # how it was found


class Step(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One line of a script (Figure 4): do, resource, destination, stop class, interpolation space, trims."""

    do: str  # "proc", "move", "let", "grip", "hold": a row of the binder's program
    label: str  # in words, for people: "feel one side of the handle (GP1)"
    name: str = ""  # of the procedure, or of the value that is set
    who: str = "active_arm"
    to: str = ""  # a binding's name
    stop: str = ""  # stop class: move_free, move_to_contact ...
    space: str = ""  # move_joint, move_task
    value: str = ""  # of a "let": an expression over bindings
    op: str = ""  # of a "grip": open, close
    expect: list[StopReason] = msgspec.field(
        default_factory=lambda: [StopReason.GOAL]
    )  # the stop reasons that count as success (A13)
    keep: dict[str, str] = {}  # binding to set from the report on success: {"GP1": "report.pose"}
    trims: list[int] = []  # entries of the trimming stack that may correct it, in order (A9)
    args: dict[str, float | str] = {}  # other parameters of the program's row: speeds, thresholds, widths
    way: Way | None = None  # of the first motion of a script


class Trim(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One entry of the trimming stack: a corrective piece of script, and what follows it (A16)."""

    n: int
    label: str
    steps: list[Step]
    then: Literal["retry_step", "restart_script", "skip", "replace_rest", "give_up"] = "retry_step"
    fits: list[StopReason] = []  # the failures it may correct; empty = any


class Limits(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """MAINTAIN, as numbers. None = the program's default."""

    speed_m_s: float | None = None
    speed_ratio: float | None = None
    force_n: float | None = None
    torque_nm: float | None = None
    grip_force_n: float | None = None
    time_s: float | None = None
    clearance_m: float | None = None  # AVOID-NEIGHBORS
    keep_out: list[str] = []  # regions
    work_range: str | None = None
    attitude: str | None = None  # POSE-DURING-MOTION
    stiffness_n_m: float | None = None


class ScriptContext(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What every step of a script is bound with. Opaque to the Decision Unit."""

    verb: str
    script: str  # its name: grasp-centering
    arm: str = ""  # active_arm; empty: only a camera works
    partner: str = ""  # the arm that holds the same object and complies; empty: one arm moves
    object: str = ""  # active_object
    grasp_point: str = ""
    target: str = ""
    limits: Limits = Limits()
    guarded: bool = False
    reflexes: list[ReflexItem] = []
    report_when: list[Condition] = []
    fits: dict[int, list[StopReason]] = {}  # entry of the trimming stack -> failures it may correct; empty = any
    # Facts stated by the sentence itself, by key, SI.
    stated: dict[str, Any] = msgspec.field(default_factory=dict, name="told")


class Script(Message, frozen=True, kw_only=True):
    """Product of an elaborator: what to do, what may go wrong, what it needs (R118)."""

    context: ScriptContext
    case: int  # 1-4 (R68)
    steps: list[Step]
    trims: list[Trim] = []
    bindings: dict[str, Binding] = {}  # decided backwards from the goal (R134)
    resources: list[str] = []  # non-sharable, all or none
    writes: list[str] = []  # locations of the world that analyzers of this command may write
    reads: list[str] = []  # further locations that its plan relies on
    candidates: list[str] = []  # what was ranked, the chosen one first (R75)
    notes: list[str] = []  # log of the planning, for people: generated, tested, modified (R92)


class EvaluationContext(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What the binder expects of a primitive; the analyzer judges the report by it. Opaque to the
    Decision Unit and never sent to a subsystem."""

    context: ScriptContext
    step: Step
    arm: str = ""
    goal_pose: list[float] | None = None  # of the tcp, predicted at the goal
    goal_joints: list[float] | None = None
    held: str = ""  # the object in the hand before the primitive, if any
    predicted_s: float = 0.0
    width_m: list[float] | None = None  # for a grip: [least, most] that count as success
    no_contact_is_failure: bool = False
    slowed: str = ""  # why the motion is slower than the command allows, in words
    start_joints: list[float] | None = None
    body: str = ""  # what a camera looks for
    body_pose: list[float] | None = None  # where it should be, for a check


class ParserInput(msgspec.Struct, frozen=True, kw_only=True):
    text: str


class ElaboratorInput(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """`at_s`: when the broker asks; what a hand holds is less certain with the age of its facts. 0 = unknown."""

    command: str
    parsed: ParsedCommand
    at_s: float = 0.0
    moving: list[Primitive] = []  # of other arms: executing, or ended and not in the world database yet


class BinderInput(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """`at_s`, `moving`: as in `ElaboratorInput`. `moved_s`: how long this command has moved, in arm time."""

    primitive_id: str
    context: ScriptContext
    step: Step
    bindings: dict[str, Binding]
    at_s: float = 0.0
    moving: list[Primitive] = []
    moved_s: float = 0.0


class AnalyzerInput(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """`closing`: the command is ending, so only the world is updated and advice is ignored (R151)."""

    evaluation: EvaluationContext
    report: EndReport
    trims_used: list[int] = []  # for this step
    closing: bool = False


class BoundStep(Message, frozen=True, kw_only=True):
    """Product of a binder: a primitive with its expected result, or bindings for a step without motion, or `report`.

    `report` has the facts that the operator stated; it goes to an analyzer without a subsystem.
    """

    subsystem: str = ""  # "MCM", "S&P"; empty = nothing to execute
    primitive: Primitive | None = None
    report: EndReport | None = msgspec.field(default=None, name="told")
    evaluation: EvaluationContext | None = None
    bindings: dict[str, Binding] = {}
    limit_s: float = 0.0  # time limit of the end report, above the time limit of the primitive itself
    predicted_s: float = 0.0  # planned duration of the primitive
    note: str = ""


class Validity(StrEnum):
    UNKNOWN = "unknown"
    VALID = "valid"
    CHANGING = "changing"
    SUSPECT = "suspect"
    INVALID = "invalid"


# How well a pose is known: the half-width of its error along and about each axis of the pose's own frame,
# [x y z roll pitch yaw] (m, rad). The truth is believed to lie within these bounds.
Spread = Annotated[list[float], msgspec.Meta(min_length=6, max_length=6)]


class WorldChange(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One fact to be written. `key` is LOCATION.attribute, e.g. MACS-OLD.frame. Without a value only the
    validity changes."""

    key: str
    value: Any = None
    validity: Validity = Validity.VALID
    keep_value: bool = False  # leave the value as it is, change the validity
    spread: Spread | None = None  # as of the fact; with `keep_value`, None keeps what it was


class Assessment(Message, frozen=True, kw_only=True):
    """Product of an analyzer (R122): continue, trim or abort; and the changes of the world."""

    verdict: Literal["continue", "trim", "abort"]
    reason: StopReason  # after derivation: NO_CONTACT where goal was reached and a touch expected
    message: str = ""
    trim: int = 0  # entry of the trimming stack to push
    keep: dict[str, Binding] = {}  # measured values for later steps
    changes: list[WorldChange] = []
    clears: str = ""  # what would clear the failure


# --- 4. broker <-> subsystems -------------------------------------------------------------------------


class SubsystemHello(Message, frozen=True, kw_only=True):
    """A subsystem is ready. `outstanding`: primitives it executes or whose report is not acknowledged."""

    name: Name  # MCM, S&P
    pid: int
    performers: Annotated[list[Name], msgspec.Meta(max_length=10_000)]  # LEFT-ARM, RIGHT-ARM
    # Those that take several primitives at once and serve them in turn: cameras.
    queues: Annotated[list[Name], msgspec.Meta(max_length=10_000)] = []
    outstanding: Annotated[list[Name], msgspec.Meta(max_length=10_000)] = []
    at_rest: bool = True
    arrays: bool = False  # as in ClientHello
    pauses: bool = False  # it obeys Pace; else its commands pause between two steps only
    paused: Annotated[list[Name], msgspec.Meta(max_length=10_000)] = []  # primitives that it was ordered to pause


class Execute(Message, frozen=True, kw_only=True):
    """Execute a primitive. A repeated one is executed once. One that the broker sent before it knew of a halt is not
    begun after that halt."""

    primitive: Primitive
    issued_at_s: float = 0.0
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


class Pace(Message, frozen=True, kw_only=True):
    """Pause a primitive on its path, or let it go on. Repeating it changes nothing; one that has ended ignores it.

    F is checked during a pause. A time limit does not count from the order to pause until the order to go on."""

    primitive: Name
    paused: bool


class Injected(Message, frozen=True, kw_only=True):
    """The faults that are injected in a simulated subsystem, for `rtc status`; after each change and each hello."""

    active: Annotated[list[Name], msgspec.Meta(max_length=1000)] = []


class ReportAck(Message, frozen=True, kw_only=True):
    """The broker has journalled the end report of this primitive; the subsystem may forget it."""

    primitive: str


class Started(Message, frozen=True, kw_only=True):
    primitive: str
    at_s: float


class Paced(Message, frozen=True, kw_only=True):
    """A primitive has come to rest on its path, or has gone on from there."""

    primitive: str
    at_s: float
    paused: bool
    done: float = 0.0  # part of the duration of its trajectory, 0 to 1


class ProgressReport(Message, frozen=True, kw_only=True):
    """A report during a motion or a look: at the period requested in R, or because a condition of R is true.

    Only an arm has joints, wrench and tcp pose."""

    primitive: str
    at_s: float
    joints: list[float] = []
    wrench: list[float] = []
    tcp_pose: list[float] = []
    condition: int | None = None  # number of the condition; None: a periodic report
    measured: float | None = None  # what the condition compares
    limit: float | None = None
    sighting: Sighting | None = None  # of a camera: the latest pose of the body


class EndReport(Message, frozen=True, kw_only=True):
    """The one end report of a primitive: what, where, why (R65). Repeated until it is acknowledged.

    Joints, poses, wrenches and the hand are those of an arm; of a camera they are empty, and it has a sighting."""

    primitive: Name
    performer: Name
    reason: StopReason
    at_s: float
    duration_s: float  # in the time of the simulation, pauses included
    joints: list[float] = []  # rad, after coming to rest
    tcp_pose: list[float] = []  # at rest
    wrench: list[float] = []  # at rest
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


# --- 5. workers and others <-> world database ---------------------------------------------------------


class Fact(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    key: str  # LOCATION.attribute
    value: Any
    validity: Validity
    version: int  # of the world when it was written
    source: str  # origin: "cell", "C-7/12", ...
    at_s: float
    spread: Spread | None = None  # of a pose; None = not stated


class ReadView(Message, frozen=True, kw_only=True):
    """One grouped read (R147): all facts, or those of some keys or locations; only facts newer than `since`."""

    request: Name
    keys: Annotated[list[Name], msgspec.Meta(max_length=10_000)] | None = None
    since: int = 0


class View(Message, frozen=True, kw_only=True):
    request: str
    version: int
    facts: list[Fact]


class Commit(Message, frozen=True, kw_only=True):
    """Write, once per job: the same job again gets the same answer and changes nothing."""

    request: Name
    lease: Lease
    changes: list[WorldChange]
    source: str


class Doubt(Message, frozen=True, kw_only=True):
    """Facts that a motion changes become suspect; the same lease again changes nothing.

    By a lease of the broker for itself: all of them, because it is unknown what was executed. By the lease of an
    analysis that was given up: those of its locations, unless that job has written its changes before."""

    request: Name
    lease: Lease
    why: Name  # becomes the source of the doubt


class Committed(Message, frozen=True, kw_only=True):
    request: str
    version: int
    again: bool = False  # this job had been committed before


class WorldHistory(Message, frozen=True, kw_only=True):
    request: Name
    key: Name
    limit: int = 100  # at most 1000 are sent


class WorldRefused(Message, frozen=True, kw_only=True):
    request: str
    refusal: Refusal


# --- 6. supervisor <-> broker -------------------------------------------------------------------------


class SupervisorHello(Message, frozen=True, kw_only=True):
    pid: int


class ProcessExited(Message, frozen=True, kw_only=True):
    """A process of the cluster has ended."""

    name: Name  # "binder@2", "MCM", "world"
    pid: int
    status: int  # as from waitpid: negative = signal
    restarting: bool


class ProcessRow(TypedDict):
    """A process as the supervisor knows it; a plain map, because `rtc status` passes it on unchanged."""

    name: Name
    pid: int
    state: Name
    since_s: float  # CLOCK_MONOTONIC
    restarts: NotRequired[int]
    notes: NotRequired[list[str]]  # warnings: a database set aside, the last output of a crash loop
    node: NotRequired[int | None]  # a worker's address


class Asked(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The latest run of the command line for more workers of a kind (`rtc up --more`)."""

    kind: WorkerKind
    count: int
    had: int  # workers of this kind on other machines at that time
    at_s: float  # CLOCK_MONOTONIC
    running: bool = False
    failed: str = ""  # why it failed, in words; empty = it succeeded or is running
    output: Name = ""  # its last line


class ProcessTable(Message, frozen=True, kw_only=True):
    """All processes of the cluster, for `rtc status`."""

    processes: Annotated[list[ProcessRow], msgspec.Meta(max_length=10_000)]
    asked: Annotated[list[Asked], msgspec.Meta(max_length=100)] = []


class FarWorker(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A worker on another machine, as the gateway knows it."""

    name: Name
    last_message_at_s: float  # its latest message
    round_trip_s: float | None = None  # gateway -> worker -> gateway; None = not measured
    round_trip_at_s: float = 0.0


class PeerRow(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What the gateway knows of the holder of a key on one host. A time of 0 means never."""

    key: Name  # its name; empty = an unknown key
    role: Name = ""
    host: Name = ""  # network address; empty = the key was not used yet
    asked: int = 0  # number of workers that are to use this key, as in `rtc keys new --count`
    revoked: bool = False
    workers: list[FarWorker] = []
    lost: dict[str, float] = {}  # worker that is not connected any more -> when its connection was lost
    connections: int = 0
    last_message_at_s: float = 0.0
    refused: int = 0
    refusal: Name = ""  # the latest, in words
    refused_at_s: float = 0.0


class GatewayReport(Message, frozen=True, kw_only=True):
    """The peers on other machines, for `rtc status`. Sent twice a second by the gateway."""

    peers: Annotated[list[PeerRow], msgspec.Meta(max_length=1_000)]


class KillProcess(Message, frozen=True, kw_only=True):
    """Ask the supervisor to kill -9 a hung process and start it anew."""

    name: str
    pid: int
    why: str


class AllEnded(Message, frozen=True, kw_only=True):
    """Answer to the supervisor's Shutdown: every command has ended, and its client has been sent the outcome."""

    commands: list[str]  # that were live at the Shutdown
    arms: list[str] = []  # that were in motion at the Shutdown


class SpawnWorker(Message, frozen=True, kw_only=True):
    kind: WorkerKind


class RetireWorker(Message, frozen=True, kw_only=True):
    name: str


class AskMore(Message, frozen=True, kw_only=True):
    """Run the user's command line for more workers on other machines, unless it runs already."""

    kind: WorkerKind
    count: int
    had: int  # workers of this kind on other machines


# --- 7. subsystem -> subscribers: telemetry (PUB) ---------------------------------------------------------


class ArmSample(msgspec.Struct, frozen=True, kw_only=True):
    joints: list[float]
    velocities: list[float]
    wrench: list[float]
    tcp_pose: list[float]
    hand_width_m: float
    primitive: str  # being executed; empty = holding


class Telemetry(Message, frozen=True, kw_only=True):
    subsystem: str
    at_s: float
    sim_s: float
    late_ticks: int  # since the start
    ticks: int
    arms: dict[str, ArmSample]


# --- 8. test bench <-> simulator: not available from real subsystems -----------------------------------


class SimTruth(Message, frozen=True, kw_only=True):
    request: Name


class SimTruthReply(Message, frozen=True, kw_only=True):
    request: str
    sim_s: float
    poses: dict[str, list[float]]  # every object of the cell, world frame
    velocities: dict[str, list[float]]  # linear, angular
    tcp: dict[str, list[float]]
    joints: dict[str, list[float]]
    fingers: dict[str, list[float]]  # the two finger joints, m
    held: dict[str, list[str]]  # arm -> objects that both its fingers press on
    seats: dict[str, list[float]] = {}  # every seat of the cell, world frame
    blind: list[str] = []  # cameras whose pictures are black
    at_s: float = 0.0  # when it was so, by the clock of this machine; 0: not stated


class SimDisplace(Message, frozen=True, kw_only=True):
    """Move an object and its seat in the simulator only: this makes a belief error."""

    request: Name
    object: Name
    offset: list[float]  # x y z roll pitch yaw: m, rad; world axes about the object's origin


class SimFactors(Message, frozen=True, kw_only=True):
    """Scale the mass of all movable objects and the friction of all finger pads in the simulator only. Factors of the
    cell's values; the last message counts."""

    request: Name
    mass: Annotated[float, msgspec.Meta(gt=0, le=10)] = 1.0
    friction: Annotated[float, msgspec.Meta(gt=0, le=10)] = 1.0


class SimInject(Message, frozen=True, kw_only=True):
    """Inject a fault; it replaces an active one of the same name."""

    request: Name
    fault: AnyFault


class SimUndo(Message, frozen=True, kw_only=True):
    """Undo an injected fault by its name, such as "stick RIGHT-ARM joint_3", or all of them (ALL)."""

    request: Name
    fault: Name


class SimDone(Message, frozen=True, kw_only=True):
    request: str
    error: str = ""
    note: str = ""
    active: list[str] = []  # injected faults, in words


# --- messages by direction: one union per socket and direction ----------------------------------------------

ClientToBroker = (
    ClientHello | CommandText | StatusQuery | TraceQuery | ProgramQuery | ProgramText | Shutdown | Heartbeat
)
BrokerToClient = (
    Welcome
    | Accepted
    | Declined
    | ProgressNote
    | CommandEnded
    | StatusReply
    | TraceReply
    | ProgramReply
    | ProgramLoaded
)
WorkerToBroker = WorkerHello | Heartbeat | ResultBatch | ProgramWanted | WorkerGone
BrokerToWorker = JobBatch | Drop | ProgramBody | Shutdown | WorkerAddress | Heartbeat
SubsystemToBroker = (
    SubsystemHello
    | Heartbeat
    | Started
    | Paced
    | ProgressReport
    | EndReport
    | HaltStarted
    | HaltAtRest
    | HaltOrder
    | Injected
    | Dropped
)
BrokerToSubsystem = Execute | Pace | HaltOrder | ReportAck | Declined  # Declined: the name is in use
ToHalt = HaltOrder  # on the broker's halt socket and the MCM's estop socket
FromHalt = HaltStarted | HaltAtRest | Declined
ToWorld = ReadView | Commit | WorldHistory | Doubt
FromWorld = View | Committed | WorldRefused
Event = ProgressNote | CommandEnded | RequestRefused | HaltRequested  # what the broker publishes
# Dropped, GatewayReport: from other processes
SupervisorToBroker = SupervisorHello | ProcessExited | ProcessTable | Shutdown | Dropped | GatewayReport
BrokerToSupervisor = KillProcess | SpawnWorker | RetireWorker | AskMore | Shutdown | AllEnded
ToSim = SimTruth | SimDisplace | SimFactors | SimInject | SimUndo
FromSim = SimTruthReply | SimDone
