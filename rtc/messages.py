"""All that processes say to each other, in the order of a command's journey.

Reading this file from top to bottom is reading the system. Every message is a frozen struct, on the wire a
MessagePack map whose key "type" holds the name of the class (see `rtc.wire`, which alone knows how it
becomes bytes). Unknown keys are ignored, missing keys take their defaults: that is how versions meet (R42).

Times that end in `_at_s` are CLOCK_MONOTONIC seconds of the machine they were taken on, comparable between
the processes of one host; `_s` is a duration. Poses are [x y z qx qy qz qw] (m, unit quaternion), in world
axes unless a `frame` says otherwise. A wrench is [Fx Fy Fz Tx Ty Tz] (N, N.m) that the surroundings exert on
the hand, in tool axes at the tcp. Names are upper case.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any, Literal, NotRequired, TypedDict

import msgspec

from rtc.language.record import ParsedCommand, ReflexItem
from rtc.outcomes import Measured, Outcome, Reflex, Refusal, StopReason
from rtc.primitive import Primitive


class Message(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag=True, gc=False):
    """Base of all: map on the wire, tagged with the name of the class. None refers back to itself, so the garbage
    collector need not look at them."""


# What others choose and we keep has a length; longer ones are no message.
PROGRAM_BYTES = 128 << 10  # of a program file; the longest of ours has 7 kB
Name = Annotated[str, msgspec.Meta(max_length=200)]  # characters


# --- 1. client -> broker (front door) -----------------------------------------------------------------


class CommandText(Message, frozen=True, kw_only=True):
    """A sentence. The same (client, request) sent twice is one command: a client may repeat it after a reconnect."""

    request: Name  # chosen by the client, unique for it
    text: str
    source: Literal["operator", "aip"] = "operator"  # told apart in records only (R133)
    progress: bool = True  # send ProgressNotes too, not only the end
    halt_if_lost: bool = False  # halt this command when the client goes away: it says Heartbeat every second
    # A sentence sent before a HALT ALL does not start after it; 0 = not told.
    sent_at_s: Annotated[float, msgspec.Meta(ge=0)] = 0.0
    cluster: Name = ""  # the run it is meant for, as in Welcome: another one declines it; empty = whoever hears it
    known_as: Name = ""  # C-n, when it is sent again after it was accepted


class StatusQuery(Message, frozen=True, kw_only=True):
    request: Name


class TraceQuery(Message, frozen=True, kw_only=True):
    request: Name
    command: Name  # C-n


class ProgramText(Message, frozen=True, kw_only=True):
    """LOAD: put this program document in place of, or into, the one of a kind of worker."""

    request: Name
    kind: WorkerKind
    name: Name  # of the file, for messages
    body: Annotated[bytes, msgspec.Meta(max_length=PROGRAM_BYTES)]  # YAML
    reset: bool = False  # back to the default program of this kind instead; `body` is not read
    cluster: Name = ""  # as of a CommandText


class ProgramQuery(Message, frozen=True, kw_only=True):
    """Which program a kind of worker has. Answered with ProgramReply."""

    request: Name
    kind: WorkerKind


class ClientHello(Message, frozen=True, kw_only=True):
    """First word of a client; its `client` name survives reconnects. Answered with Welcome."""

    client: Name
    at_s: float = 0.0  # the client's clock, so that a gate may tell what its times mean here; 0 = not told
    arrays: bool = False  # it reads arrays of messages too; else each message travels alone


class Shutdown(Message, frozen=True, kw_only=True):
    """Ask the cluster to end itself in order (from a client, or to a worker that retires). From the supervisor to the
    broker: halt everything, take no more commands, and answer AllEnded."""

    request: Name = ""


# --- broker -> client ---------------------------------------------------------------------------------


class Welcome(Message, frozen=True, kw_only=True):
    cluster: str  # the run's id
    pid: int
    arrays: bool = False  # the broker reads arrays of messages too


class Accepted(Message, frozen=True, kw_only=True):
    request: str
    command: str  # C-n


class Declined(Message, frozen=True, kw_only=True):
    """The request itself was no good (not a command's outcome): unknown command, queue full, bad message."""

    request: str
    refusal: Refusal


class Phase(StrEnum):
    """Where a command is. ENDED is final; HALTING and CLOSING lead only there."""

    PARSING = "parsing"
    ELABORATING = "elaborating"
    HELD = "held"  # in line for its resources
    BINDING = "binding"
    EXECUTING = "executing"
    ANALYZING = "analyzing"
    PAUSED = "paused"  # between two steps
    HALTING = "halting"  # told to stop; waiting for rest to be confirmed
    CLOSING = "closing"  # a last analysis, whose advice is ignored: what was touched becomes suspect
    ENDED = "ended"


class ProgressNote(Message, frozen=True, kw_only=True):
    """One step of one command's way, as it happens; also the line of a trace."""

    seq: int  # of the broker's event stream, rises by one; 0: a report of REPORT EVERY, which is not of that stream
    at_s: float
    command: str
    phase: Phase  # the phase it is in now
    step: str = ""  # "5 of 9: feel GP1"
    node: str = ""  # who did the work that just ended: "binder@2", "MCM"
    took_s: float = 0.0  # how long that work took, from dispatch to answer
    note: str = ""  # what came of it, in words
    expected_s: float = 0.0  # how long the step that is being executed takes, as planned; 0 = not known
    measured: Measured | None = None  # what REPORT asks for
    warning: bool = False  # the note is worth a person's attention although the command goes on


class CommandEnded(Message, frozen=True, kw_only=True):
    seq: int
    at_s: float
    command: str
    request: str
    text: str
    outcome: Outcome
    took_s: float


class StatusReply(Message, frozen=True, kw_only=True):
    request: str
    status: dict[str, Any]  # see docs/protocol.md; plain JSON types


class CommandRecord(Message, frozen=True, kw_only=True):
    """A command's whole story: live or archived."""

    command: str
    text: str
    source: str
    request: str
    accepted_at_s: float
    phase: Phase
    notes: list[ProgressNote] = []
    outcome: Outcome | None = None
    ended_at_s: float | None = None


class TraceReply(Message, frozen=True, kw_only=True):
    request: str
    record: CommandRecord


class ProgramLoaded(Message, frozen=True, kw_only=True):
    request: str
    kind: WorkerKind
    digest: str  # of the whole program
    changes: list[str] = []  # in words, one item of the program each; none: it was so before


class ProgramReply(Message, frozen=True, kw_only=True):
    request: str
    kind: WorkerKind
    digest: str
    body: bytes  # the whole program in its canonical form: JSON; for the parser a grammar


# --- 2. broker <-> workers ----------------------------------------------------------------------------


class WorkerKind(StrEnum):
    """The four phases; the value's place is the two low bits of a node's address in the cube."""

    PARSER = "parser"
    ELABORATOR = "elaborator"
    BINDER = "binder"
    ANALYZER = "analyzer"


class Lease(msgspec.Struct, frozen=True, kw_only=True):
    """Leave to write these locations, for this job. Signed by the broker, checked by the world database (A25)."""

    job: str
    locations: list[str]
    signature: bytes


class Job(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """One stateless piece of work. Its bytes and the world version it read are enough to do it again (R10)."""

    id: str  # "C-7/12": command and a number
    attempt: int  # 1, 2, 3: an answer to an older attempt is stale
    program: str  # digest
    cell: str = ""  # digest of the cell; empty = this kind of worker needs none
    input: msgspec.Raw  # ParserInput | ElaboratorInput | BinderInput | AnalyzerInput
    lease: Lease | None = None  # analyzers only


class JobBatch(Message, frozen=True, kw_only=True):
    jobs: list[Job]


class Drop(Message, frozen=True, kw_only=True):
    """These jobs are no longer wanted; one not begun need not be done."""

    jobs: list[str]


class ProgramBody(Message, frozen=True, kw_only=True):
    digest: str
    body: bytes | None  # None: no such program


class WorkerHello(Message, frozen=True, kw_only=True):
    """A worker is ready. `node` is its address in the cube, `name` "binder@2"."""

    name: Name
    node: Annotated[int, msgspec.Meta(ge=0, lt=1 << 16)]
    kind: WorkerKind
    pid: int


class Heartbeat(Message, frozen=True, kw_only=True):
    """Alive, and this is the job in hand, if any. From a worker, a subsystem, or a client that is watched."""

    name: Name
    job: Name = ""


class JobDone(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="done", gc=False):
    id: str
    attempt: int
    product: msgspec.Raw  # ParsedCommand | Script | BoundStep | Assessment
    took_s: float = 0.0
    world_version: int = 0  # the version of the world the job has read; 0 = none


class JobRefused(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="refused"):
    id: str
    attempt: int
    refusal: Refusal
    took_s: float = 0.0
    world_version: int = 0


class JobCrashed(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="crashed"):
    """The worker function raised: a bug, told with its evidence. Counts like a death of the worker."""

    id: str
    attempt: int
    evidence: str  # traceback, cut to some kB


JobResult = JobDone | JobRefused | JobCrashed


class Dropped(Message, frozen=True, kw_only=True):
    """How many messages could not be read, by socket, since the process began: for `rtc status`. Told now and then by
    the processes that have sockets of their own (MCM, world database)."""

    counts: Annotated[dict[Name, int], msgspec.Meta(max_length=10)]


class ResultBatch(Message, frozen=True, kw_only=True):
    name: str  # of the worker
    results: Annotated[list[JobResult], msgspec.Meta(max_length=1000)]


class WorkerGone(Message, frozen=True, kw_only=True):
    """Said for a worker on another machine, in its place, by the gate: its connection is lost."""

    name: Name


class ProgramWanted(Message, frozen=True, kw_only=True):
    digest: str


# --- 3. what jobs carry -------------------------------------------------------------------------------


class Binding(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A named parameter of a script: joints, a pose (in the axes of the object `frame`, if one is named), a
    number, or a name. Exactly one is set."""

    joints: list[float] | None = None  # rad
    pose: list[float] | None = None  # of the tcp
    frame: str | None = None  # the object whose axes the pose is in; None = world
    number: float | None = None
    name: str | None = None


class Way(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A way of an arm that an elaborator has found free. It holds for one question: whoever asks that of the world may
    take it, and anybody else plans anew (`workers.motion.handed`)."""

    asked: bytes  # digest of the question: joints of all arms, goal, scene, rules
    space: Literal["joint", "task"]
    s: list[float]  # parameter of each knot; rises from 0
    knots: list[list[float]]  # rad
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
    trims: list[int] = []  # entries of the trimming stack that may mend it, in order (A9)
    args: dict[str, float | str] = {}  # what else the row of the program needs: speeds, thresholds, widths
    way: Way | None = None  # of the first motion of a script


class Trim(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One entry of the trimming stack: a corrective piece of script, and what follows it (A16)."""

    n: int
    label: str
    steps: list[Step]
    then: Literal["retry_step", "restart_script", "skip", "replace_rest", "give_up"] = "retry_step"
    fits: list[StopReason] = []  # the failures it may mend; empty = any


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


class ScriptContext(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What every step of a script is bound with. Opaque to the Decision Unit."""

    verb: str
    script: str  # its name: grasp-centering
    arm: str = ""  # active_arm
    object: str = ""  # active_object
    grasp_point: str = ""
    target: str = ""
    limits: Limits = Limits()
    guarded: bool = False
    reflexes: list[ReflexItem] = []
    fits: dict[int, list[StopReason]] = {}  # entry of the trimming stack -> the failures it may mend; none = any
    told: dict[str, Any] = {}  # facts that the sentence itself tells, by key, SI


class Script(Message, frozen=True, kw_only=True):
    """Product of an elaborator: what to do, what may go wrong, what it needs (R118)."""

    context: ScriptContext
    case: int  # 1-4 (R68)
    steps: list[Step]
    trims: list[Trim] = []
    bindings: dict[str, Binding] = {}  # decided backwards from the goal (R134)
    resources: list[str] = []  # non-sharable, all or none
    queues: list[str] = []  # queue resources: one at a time, in line
    writes: list[str] = []  # locations of the world that analyzers of this command may write
    reads: list[str] = []  # further locations that its plan relies on
    candidates: list[str] = []  # what was ranked, the chosen one first (R75)
    notes: list[str] = []  # the story of the planning, for people: generated, tested, modified (R92)


class EvaluationContext(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What the binder expects of a primitive; the analyzer judges the report by it (paper, L152). Opaque to the
    Decision Unit and never sent to a subsystem."""

    context: ScriptContext
    step: Step
    arm: str = ""
    goal_pose: list[float] | None = None  # of the tcp, predicted at the goal
    goal_joints: list[float] | None = None
    held: str = ""  # the object in the hand before the primitive, if any
    predicted_s: float = 0.0
    width_m: list[float] | None = None  # for a grip: [least, most] that count as success
    force_n: float | None = None
    no_contact_is_failure: bool = False
    start_joints: list[float] | None = None


class ParserInput(msgspec.Struct, frozen=True, kw_only=True):
    text: str


class ElaboratorInput(msgspec.Struct, frozen=True, kw_only=True):
    command: str
    parsed: ParsedCommand


class BinderInput(msgspec.Struct, frozen=True, kw_only=True):
    primitive_id: str
    context: ScriptContext
    step: Step
    bindings: dict[str, Binding]


class AnalyzerInput(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """`closing`: the command is being ended, so no advice is wanted; only the world is put right (R151)."""

    evaluation: EvaluationContext
    report: EndReport
    trims_used: list[int] = []  # for this step
    closing: bool = False


class BoundStep(Message, frozen=True, kw_only=True):
    """Product of a binder: a primitive with what is expected of it; or, for a step that moves nothing, bindings; or
    what somebody has told, which is a report already and needs no subsystem, but an analyzer like any other."""

    subsystem: str = ""  # "MCM"; empty = nothing to execute
    primitive: Primitive | None = None
    told: EndReport | None = None
    evaluation: EvaluationContext | None = None
    bindings: dict[str, Binding] = {}
    limit_s: float = 0.0  # longest time until an end report, with the arm's own limit well inside
    predicted_s: float = 0.0  # how long the primitive takes when nothing happens
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
    """Product of an analyzer (R122): go on, mend, or give up; and what the world is like now."""

    verdict: Literal["continue", "trim", "abort"]
    reason: StopReason  # after derivation: NO_CONTACT where goal was reached and a touch expected
    message: str = ""
    trim: int = 0  # the entry to push
    keep: dict[str, Binding] = {}  # measured values for later steps
    changes: list[WorldChange] = []
    clears: str = ""  # what would clear the trouble


# --- 4. broker <-> subsystems -------------------------------------------------------------------------


class SubsystemHello(Message, frozen=True, kw_only=True):
    """A subsystem is there. `outstanding` are the primitives it executes or has an unacknowledged report of."""

    name: Name  # MCM
    pid: int
    performers: Annotated[list[Name], msgspec.Meta(max_length=10_000)]  # LEFT-ARM, RIGHT-ARM
    outstanding: Annotated[list[Name], msgspec.Meta(max_length=10_000)] = []
    at_rest: bool = True
    arrays: bool = False  # as in ClientHello


class Execute(Message, frozen=True, kw_only=True):
    """Perform this. The same primitive twice is executed once; one the broker sent before it knew of a halt is not
    begun after that halt."""

    primitive: Primitive
    issued_at_s: float = 0.0
    pid: int = 0  # of the process it is meant for, as told in its hello; another passes it over; 0 = any


class HaltOrder(Message, frozen=True, kw_only=True):
    """Stop now. `scope`: ALL, a performer, or a command number, which stops the primitives that begin with it.

    It is obeyed whenever it is received, also when its name was used before. From a subsystem to the broker: a halt
    that was called past the broker. Nothing in its scope begins until the broker has answered with the same order; it
    is said again with every hello until then."""

    halt: Name
    scope: Name = "ALL"
    called_at_s: float = 0.0  # when the operator called
    call: Name = ""  # the sender's own number for this order; answers to it repeat it


class ReportAck(Message, frozen=True, kw_only=True):
    """The end report of this primitive is journalled; it need not be kept any longer."""

    primitive: str


class Started(Message, frozen=True, kw_only=True):
    primitive: str
    at_s: float


class ProgressReport(Message, frozen=True, kw_only=True):
    """A report while moving, at the period that R asks for."""

    primitive: str
    at_s: float
    joints: list[float]
    wrench: list[float]
    tcp_pose: list[float]


class EndReport(Message, frozen=True, kw_only=True):
    """The one end report of a primitive: what, where, why (R65). Repeated until it is acknowledged."""

    primitive: Name
    performer: Name
    reason: StopReason
    at_s: float
    duration_s: float  # in the time of the simulation
    joints: list[float]  # rad, after coming to rest
    tcp_pose: list[float]  # at rest
    wrench: list[float]  # at rest
    hand_width_m: float
    hand_force_n: float  # pressed by the fingers, the smaller of the two
    peak_force_n: float = 0.0  # while moving
    peak_torque_nm: float = 0.0
    trip_pose: list[float] | None = None  # of the tcp, in the tick that tripped
    trip_wrench: list[float] | None = None
    measured: float | None = None  # the figure that tripped, and
    limit: float | None = None  # the limit it passed
    message: str = ""  # for REFUSED: why; for COLLISION: the bodies' link names
    reflex: Reflex = Reflex.STOP  # what was done after the stop: BACK_OFF, RELEASE
    facts: dict[str, Any] = {}  # what was told or seen, by key (MACS-OLD.frame), SI; an analyzer judges and writes it


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
    source: str  # who told: "cell", "C-7/12", ...
    at_s: float
    spread: Spread | None = None  # of a pose; None = nobody has stated any


class ReadView(Message, frozen=True, kw_only=True):
    """One grouped read (R147): all facts, or those of some keys or locations; only what is newer than `since`."""

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
    """From the broker alone, by a lease for no location: nobody knows what was done. Every fact that a motion changes
    becomes suspect; the same lease again changes nothing."""

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
    limit: int = 100  # at most 1000 are told


class WorldRefused(Message, frozen=True, kw_only=True):
    request: str
    refusal: Refusal


# --- 6. supervisor <-> broker -------------------------------------------------------------------------


class SupervisorHello(Message, frozen=True, kw_only=True):
    pid: int


class ProcessExited(Message, frozen=True, kw_only=True):
    """A process of the cluster has ended; the supervisor saw it first."""

    name: Name  # "binder@2", "MCM", "world"
    pid: int
    status: int  # as from waitpid: negative = signal
    restarting: bool


class ProcessRow(TypedDict):
    """A process as the supervisor sees it; a plain map, because `rtc status` shows it as it is."""

    name: Name
    pid: int
    state: Name
    since_s: float  # CLOCK_MONOTONIC
    restarts: NotRequired[int]
    notes: NotRequired[list[str]]  # what people should know of it: a database put aside, a crash loop's last words
    node: NotRequired[int | None]  # a worker's address


class ProcessTable(Message, frozen=True, kw_only=True):
    """What runs: for `rtc status`."""

    processes: Annotated[list[ProcessRow], msgspec.Meta(max_length=10_000)]


class KillProcess(Message, frozen=True, kw_only=True):
    """Ask the supervisor to kill -9 a hung process and start it anew."""

    name: str
    pid: int
    why: str


class AllEnded(Message, frozen=True, kw_only=True):
    """Answer to the supervisor's Shutdown: every command has ended, and its client has been sent the outcome."""

    commands: list[str]  # that were live when the cluster was told to end
    arms: list[str] = []  # that were in motion then


class SpawnWorker(Message, frozen=True, kw_only=True):
    kind: WorkerKind


class RetireWorker(Message, frozen=True, kw_only=True):
    name: str


# --- 7. subsystem -> anybody: telemetry (PUB) ---------------------------------------------------------


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


# --- 8. test bench <-> simulator: what no real subsystem would tell -----------------------------------


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


class SimDisplace(Message, frozen=True, kw_only=True):
    """Move an object, with the seat it sits in, without telling the RTC: a belief error."""

    request: Name
    object: Name
    offset: list[float]  # x y z roll pitch yaw: m, rad; world axes about the object's origin


class SimFactors(Message, frozen=True, kw_only=True):
    """Make all things that can be moved heavier, and the pads of all hands rub less, than the cell says: what the RTC
    counts on is not so. Factors of the cell's figures; the last ones count."""

    request: Name
    mass: Annotated[float, msgspec.Meta(gt=0, le=10)] = 1.0
    friction: Annotated[float, msgspec.Meta(gt=0, le=10)] = 1.0


class SimDone(Message, frozen=True, kw_only=True):
    request: str
    error: str = ""


# --- who may say what: one union per socket and direction ----------------------------------------------

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
BrokerToWorker = JobBatch | Drop | ProgramBody | Shutdown
SubsystemToBroker = (
    SubsystemHello | Heartbeat | Started | ProgressReport | EndReport | HaltStarted | HaltAtRest | HaltOrder | Dropped
)
BrokerToSubsystem = Execute | HaltOrder | ReportAck | Declined  # Declined: the name is another's
ToHalt = HaltOrder  # on the broker's halt socket and the MCM's estop socket
FromHalt = HaltStarted | HaltAtRest | Declined
ToWorld = ReadView | Commit | WorldHistory | Doubt
FromWorld = View | Committed | WorldRefused
SupervisorToBroker = SupervisorHello | ProcessExited | ProcessTable | Shutdown | Dropped  # Dropped: from others
BrokerToSupervisor = KillProcess | SpawnWorker | RetireWorker | Shutdown | AllEnded
ToSim = SimTruth | SimDisplace | SimFactors
FromSim = SimTruthReply | SimDone
