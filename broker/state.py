"""All that the Decision Unit remembers. Plain data, encodable as it stands: a snapshot is one `encode`.

What the Decision Unit must not look into (contexts, steps, values, primitives) is kept as `msgspec.Raw`, the
bytes as they came; the *Head types below name the few fields of a product that it does read.
"""

from __future__ import annotations

from enum import StrEnum

import msgspec

from broker.resources import Resources
from rtc.messages import Phase, ProgressNote, WorkerKind
from rtc.outcomes import Measured, OutcomeKind, Refusal, StopReason

NOTES_KEPT = 400  # of one command's story; a longer one loses its middle
NOMINAL = 0  # the "trim" number of the script's own steps

NIL = msgspec.Raw(b"\xc0")  # MessagePack's nil: no bytes of this kind

StepRef = tuple[int, int]  # (NOMINAL or number of a trim, index of the step in it)


class ReportHead(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """REPORT of a ParsedCommand."""

    joints: bool = False
    forces: bool = False
    pose: bool = False
    every_s: float | None = None


class ParsedHead(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """Of a ParsedCommand: how the command relates to others, never what it does."""

    kind: str
    verb: str
    test: bool = False
    hand: str | None = None
    to_hand: str | None = None
    object: str | None = None
    after: str | None = None
    together_with: str | None = None
    now: bool = False
    report: ReportHead | None = None


class StepHead(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    label: str


class TrimHead(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    n: int
    label: str
    steps: list[msgspec.Raw]
    then: str = "retry_step"


class ScriptHead(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    context: msgspec.Raw
    steps: list[msgspec.Raw]
    trims: list[TrimHead] = []
    bindings: dict[str, msgspec.Raw] = {}
    resources: list[str] = []
    queues: list[str] = []
    writes: list[str] = []
    reads: list[str] = []
    notes: list[str] = []


class BoundHead(msgspec.Struct, frozen=True, kw_only=True, tag="BoundStep", gc=False):
    subsystem: str = ""
    primitive: msgspec.Raw = NIL
    report: msgspec.Raw = msgspec.field(default=NIL, name="told")  # end report of a step without a subsystem
    evaluation: msgspec.Raw = NIL
    bindings: dict[str, msgspec.Raw] = {}
    limit_s: float = 0.0
    predicted_s: float = 0.0
    note: str = ""


class AssessmentHead(msgspec.Struct, frozen=True, kw_only=True, tag="Assessment", gc=False):
    verdict: str
    reason: StopReason
    message: str = ""
    trim: int = 0
    keep: dict[str, msgspec.Raw] = {}
    clears: str = ""


class PendingJob(msgspec.Struct, kw_only=True, gc=False):
    """The one job of a command that is given out. Its input is kept: it may have to be given out again."""

    id: str
    attempt: int
    kind: WorkerKind
    program: str
    input: msgspec.Raw
    locations: list[str] | None = None
    since_s: float = 0.0
    deaths: list[str] = []  # evidence of the workers it was in the hands of when they died


class DeferredAnalysis(msgspec.Struct, frozen=True):
    """The last analysis of a command that has ended, and what stays closed until the world has it."""

    job: PendingJob
    names: list[str]


class PendingOutcome(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """How a command that cannot end at once (HALTING, CLOSING) will end."""

    kind: OutcomeKind
    message: str
    stop: StopReason | None = None
    refusal: Refusal | None = None


class Command(msgspec.Struct, kw_only=True, omit_defaults=True, gc=False):
    id: str
    client: str
    request: str
    text: str
    source: str
    progress: bool
    halt_if_lost: bool
    accepted_at_s: float
    given_at_s: float = 0.0  # when its client said it: what was given before a halt does not start after it
    phase: Phase = Phase.PARSING
    jobs: int = 0  # given out so far; numbers the next
    job: PendingJob | None = None
    parsed: msgspec.Raw = NIL
    head: ParsedHead | None = None
    script: ScriptHead | None = None
    labels: list[str] = []  # of the nominal steps
    bindings: dict[str, msgspec.Raw] = {}
    stack: list[StepRef] = []  # the Action_Stack; its last element is next
    step: StepRef | None = None  # being bound, executed or analysed
    step_words: str = ""  # the same for people: "5 of 9: feel one side"
    trims_used: dict[str, list[int]] = {}  # "trim/index" of a step -> entries used for it
    trim_labels: list[str] = []
    given_up: PendingOutcome | None = None  # how it ends once the steps on the stack are done
    steps_done: int = 0
    elaborations: int = 0
    primitive: str = ""  # being executed
    primitives: int = 0
    primitive_body: msgspec.Raw = NIL  # until its end is reported: it may have to be sent again
    subsystem: str = ""
    performers: list[str] = []
    evaluation: msgspec.Raw = NIL
    sent_at_s: float = 0.0
    limit_s: float = 0.0
    due_s: float = 0.0  # when its timer rings; 0 = it has none
    at_rest: bool = True  # nothing moves for it: never did, or a report or a halt has told so
    pause_wanted: bool = False  # takes effect between two steps
    pending_outcome: PendingOutcome | None = None
    unconfirmed: list[str] = []  # of a HALT sentence: subsystems that were told and have not confirmed rest
    notes: list[ProgressNote] = []
    previous: str = ""  # the command that its client gave before it: AFTER LAST
    measured: Measured | None = None  # at the end of its last primitive, as far as REPORT asks for it


class Link(StrEnum):
    CONNECTED = "connected"
    AWAITED = "awaited"  # the broker has restarted and has not heard of it yet; it goes on by itself meanwhile
    LOST = "lost"


class Subsystem(msgspec.Struct, kw_only=True):
    pid: int
    performers: list[str]
    link: Link = Link.CONNECTED
    came_at_rest: bool = True  # as it said when it came; False once it is lost


class Trial(msgspec.Struct, frozen=True):
    """A program just loaded, and the one to go back to if its first job fails."""

    new: str
    old: str


class Result(msgspec.Struct, frozen=True, gc=False):
    """What is kept of a command that has ended."""

    message: msgspec.Raw  # CommandEnded, for a client that asks again
    succeeded: bool  # for AFTER
    request: str  # its key in `requests`


def request_key(client: str, request: str) -> str:
    return f"{client} {request}"


class State(msgspec.Struct, kw_only=True):
    commands: dict[str, Command] = {}  # live ones, by id, in order of acceptance
    live: dict[str, int] = {}  # client -> how many of them are its own
    intake_order: dict[str, dict[str, bool]] = {}  # client -> {command: parsed?}
    accepted: int = 0
    last_given: dict[str, str] = {}  # client -> its latest command; of the clients that gave one last
    life: str = ""  # of the journal: part of the names of primitives; see rtc.primitive_id
    lost: str = ""  # why the journal lacks turns, in words; empty = it never lost any
    lost_at_s: float = 0.0  # when that was noticed: what was sent before is not begun
    began_at_s: float = 0.0  # the cluster, not this broker
    seq: int = 0  # of the event stream
    requests: dict[str, str] = {}  # `request_key` -> command, live or recently ended
    ended: dict[str, Result] = {}  # recently ended, by command
    resources: Resources = msgspec.field(default_factory=Resources)
    awaiting: dict[str, list[str]] = {}  # command -> those that start after its end
    joining: dict[str, list[str]] = {}  # command -> those that start when it begins to move
    subsystems: dict[str, Subsystem] = {}
    programs: dict[str, str] = {}  # kind (or "cell") -> digest
    program_files: dict[str, tuple[str, float]] = {}  # digest -> file that was loaded last into it, when
    deferred_analyses: dict[str, DeferredAnalysis] = {}  # ended command -> its analysis
    trials: dict[str, Trial] = {}
    proven: dict[str, list[str]] = {}  # kind -> programs that have done a job well, the latest last
    rolled_back: dict[str, str] = {}  # kind -> why its newest program was taken back, until the next one is loaded
    halted_at_s: dict[str, float] = {}  # scope of a halt -> when: what was sent before it does not start
    halts: dict[str, float] = {}  # the last few -> when: one that came by two doors is counted once, and obeyed twice
    has_subscribers: bool = False  # somebody hears the event stream
    timeout_scale: float = 1.0  # seconds of ours per simulated second: limits of primitives are in simulated time
    counts: dict[str, int] = {}  # ended by outcome, stale answers, trims, ...
