"""The state of the Decision Unit: plain data that one `encode` turns into a snapshot.

What every live command has is a tuple rather than a list where it can be: an empty one takes neither memory nor time.
Contexts, steps, values and primitives stay `msgspec.Raw`, the bytes as received: the Decision Unit must not read them.
The *Head types below declare the few fields of a product that it reads.
"""

from __future__ import annotations

from enum import StrEnum

import msgspec

from broker.decisions.resources import Resources
from rtc.programs.action_stack import ActionStack
from rtc.protocol.advice import Advice
from rtc.protocol.messages import (
    Breakpoint,
    OperatorAnswer,
    Phase,
    PictureTime,
    ProgressNote,
    RestsOn,
    SavedWorld,
    WorkerKind,
)
from rtc.protocol.outcomes import Compared, Measured, OutcomeKind, Refusal, StopReason
from rtc.protocol.primitive import Box
from rtc.protocol.rehearsal import Rehearsal
from rtc.protocol.sentence import Condition

NOTES_KEPT = 400  # maximum length of one command's trace; entries in the middle are dropped

SPACES_KEPT = 16  # motions begun meanwhile, at most, that a plan is compared with; beyond it, it is made again
NIL = msgspec.Raw(b"\xc0")  # MessagePack nil: the value is absent


class ReportHead(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """The REPORT clause of a ParsedCommand."""

    every_s: float | None = None
    when: list[Condition] = []

    @property
    def in_motion(self) -> str:
        """The word of the clause that requests reports during motion; empty if none does."""
        return "EVERY" if self.every_s is not None else "WHEN" if self.when else ""


class ParsedHead(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """The fields of a ParsedCommand that relate it to other commands; its task is opaque here."""

    kind: str
    verb: str
    test: bool = False
    hand: str | None = None
    to_hand: str | None = None
    object: str | None = None
    attribute: str | None = None
    target: str | None = None
    after: str | None = None
    together_with: str | None = None
    now: bool = False
    report: ReportHead | None = None
    reason: str | None = None


class StepHead(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """The label of a step."""

    label: str


class TrimHead(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """A trim: its steps and what follows them."""

    n: int
    label: str
    steps: tuple[msgspec.Raw, ...]
    then: str = "retry_step"


class ScriptHead(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """Product of the elaborator: steps, trims and the names to claim."""

    context: msgspec.Raw
    case: int
    steps: tuple[msgspec.Raw, ...]
    trims: tuple[TrimHead, ...] = ()
    bindings: dict[str, msgspec.Raw] = {}
    resources: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


class BoundHead(msgspec.Struct, frozen=True, kw_only=True, tag="BoundStep", gc=False):
    """Product of the binder: one primitive, or the report of a step that needs no subsystem."""

    subsystem: str = ""
    primitive: msgspec.Raw = NIL
    report: msgspec.Raw = msgspec.field(default=NIL)  # end report of a step without a subsystem
    evaluation: msgspec.Raw = NIL
    bindings: dict[str, msgspec.Raw] = {}
    limit_s: float = 0.0
    predicted_s: float = 0.0
    note: str = ""
    remark: str = ""


class AssessmentHead(msgspec.Struct, frozen=True, kw_only=True, tag="Assessment", gc=False):
    """Product of the analyzer: the verdict on one report."""

    verdict: str
    reason: StopReason
    message: str = ""
    trim: int = 0
    further: tuple[int, ...] = ()
    keep: dict[str, msgspec.Raw] = {}
    clears: Advice = []
    by_operator: str = ""
    remark: str = ""
    compared: Compared | None = None
    found: str = ""
    drift: str = ""


class RehearsedHead(msgspec.Struct, frozen=True, kw_only=True, tag="Rehearsed", gc=False):
    """Product of a rehearser."""

    rehearsal: Rehearsal
    parsed: msgspec.Raw
    after: msgspec.Raw
    refusal: Refusal | None = None
    step: str = ""


class Tested(msgspec.Struct, kw_only=True):
    """A sentence that was rehearsed, as long as its digest is known."""

    before: str
    """Digest of the test of the sentence before it in its list; empty: it was the first."""
    record: msgspec.Raw
    """Its ParsedCommand without TEST."""
    feasible: bool
    relies_on: dict[str, int]
    """Facts of the world database that it rests on, with their versions."""
    foreseen: list[str]
    """Facts that it rests on as the sentences before it leave them."""
    programs: dict[str, str]
    """As in `Command.programs`."""
    paper: msgspec.Raw
    """The world after it, input of the rehearsal of the next sentence."""
    given: list[str] = []
    """Commands that were given on the strength of this test."""


class TakenProgram(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """A program that was taken into use, for people: they know files, not digests."""

    digest: str
    file: str = ""
    at_s: float
    changes: list[str] = []


class JobKind(StrEnum):
    """What is done for a command."""

    STAGE = "stage"  # a worker performs the function of its kind
    REHEARSAL = "rehearsal"  # a rehearser performs a TEST sentence, with the programs of all kinds
    SUSPECT = "suspect"  # the analysis was given up: an analyzer only makes the facts of `locations` suspect
    LOAD = "load"  # the broker itself loads a part of a delivered program


class PendingJob(msgspec.Struct, kw_only=True, gc=False):
    """The current job of a command. Its input is kept, because the job may have to be dispatched again."""

    id: str
    """C-n/k: the k-th job of command C-n."""
    attempt: int
    """Rises with each dispatch; an answer to an earlier attempt is stale."""
    worker: WorkerKind
    """The kind of worker that does it; of LOAD the kind whose program changes."""
    kind: JobKind = JobKind.STAGE
    """What is done, and by whom."""
    about: str = ""
    """Of SUSPECT: why the analysis was given up. Of LOAD: the name of the part. Otherwise empty."""
    program: str
    """Digest of the program that the worker uses."""
    input: msgspec.Raw
    """The encoded input of the worker function."""
    locations: tuple[str, ...] | None = None
    """Names that an analyzer may write; None for the other kinds, which write nothing."""
    since_s: float = 0.0
    """Time when the job was created."""
    deaths: tuple[str, ...] = ()
    """Evidence of each worker that died while it processed this job."""


class ArmMotion(msgspec.Struct, kw_only=True, gc=False):
    """A motion of an arm, from its order until the world database has its result: other arms plan beside it."""

    command: str
    """Command that moves the arm."""
    primitive: str
    """Id of the primitive."""
    body: msgspec.Raw
    """The encoded primitive, input of the binders of other arms."""
    space: list[Box] = []
    """The space of the primitive."""
    beside: tuple[str, ...] = ()
    """Ids of the motions of other arms that its binder knew."""
    started_s: float = 0.0
    """Time when the subsystem reported its start; 0: it has not."""


class Deferral(StrEnum):
    """State of a deferred analysis (`broker.decisions.deferred_analysis`)."""

    NONE = "none"  # it is not in the state
    RUNNING = "running"  # its job has a worker, or waits for one
    WAITING = "waiting"  # a timer runs until its next attempt


class DeferredAnalysis(msgspec.Struct, kw_only=True):
    """The last analysis of a command that has ended."""

    job: PendingJob
    """The job, taken over from the command."""
    names: list[str]
    """Names that stay quarantined until it is done."""
    phase: Deferral = Deferral.RUNNING
    """Row of its transition table."""


class PendingOutcome(msgspec.Struct, frozen=True, omit_defaults=True, gc=False):
    """How a command ends, or will end (HALTING, CLOSING)."""

    kind: OutcomeKind
    message: str
    stop: StopReason | None = None
    refusal: Refusal | None = None
    rehearsal: Rehearsal | None = None
    scope: str = ""
    """Of the halt that ends it."""


class Command(msgspec.Struct, kw_only=True, omit_defaults=True, gc=False):
    """One live command. All times are CLOCK_MONOTONIC, in seconds."""

    id: str
    """C-n, numbered in order of acceptance."""
    client: str
    """Identity of the client that gave it."""
    request: str
    """The client's name of its request."""
    text: str
    """The sentence, cut to `decide.MAX_TEXT` characters."""
    source: str
    """Origin that the client states: operator, aip or another."""
    progress: bool
    """The client wants progress notes."""
    halt_if_lost: bool
    """The command is halted when its client disappears."""
    accepted_at_s: float
    """Time of acceptance."""
    unwatched: bool = False
    """Accepted while the event stream was crowded: subscribers get its end, but not its notes."""
    given_at_s: float = 0.0
    """Time at the client; a halt after this time stops the command before it starts."""
    programs: dict[str, str] = {}
    """Worker kind (or "cell") -> digest of the program in use when it was accepted: all its jobs use these."""
    phase: Phase = Phase.PARSING
    """Row of the transition table."""
    jobs: int = 0
    """Number of jobs created so far; the next job id is one higher."""
    job: PendingJob | None = None
    """The job that a worker has, or that waits for one."""
    saved: SavedWorld | None = None
    """Facts that the sentence refers to, input of the elaborator."""
    parsed: msgspec.Raw = NIL
    """The whole ParsedCommand, input of the elaborator."""
    head: ParsedHead | None = None
    """The fields of `parsed` that the Decision Unit reads."""
    actions: ActionStack[ScriptHead, msgspec.Raw] | None = None
    """Its plan; None until its resources are granted."""
    step_text: str = ""
    """The current step for people: "5 of 9: feel one side"."""
    starts_after: str = ""
    """The commands whose arms must leave first, until its primitive has started."""
    given_up: PendingOutcome | None = None
    """The outcome once the steps of a `give_up` trim are done."""
    steps_done: int = 0
    """Number of successful steps."""
    elaborations: int = 0
    """Number of elaborations, limited by `MAX_ELABORATIONS`."""
    primitive: str = ""
    """Id of the latest primitive; empty before the first."""
    primitives: int = 0
    """Number of primitives sent so far."""
    primitive_body: msgspec.Raw = NIL
    """The encoded primitive until its end report, because it may be sent again."""
    subsystem: str = ""
    """Name of the subsystem that executes the latest primitive."""
    performers: tuple[str, ...] = ()
    """Arms or hands of that subsystem that move."""
    operated: bool = False
    """The operator performs the latest primitive."""
    evaluation: msgspec.Raw = NIL
    """Expected result of the step, input of the analyzer."""
    sent_at_s: float = 0.0
    """Time when the latest primitive was sent."""
    limit_s: float = 0.0
    """Time limit of the latest primitive, in simulated seconds."""
    due_s: float = 0.0
    """Expiry time of its timer; 0 = the timer is stopped."""
    at_rest: bool = True
    """Nothing moves for it: before the first primitive, or after a report or confirmed rest."""
    pause_wanted: bool = False
    """A pause takes effect before the next step."""
    single_step: bool = False
    """Pause after each step, until RESUME."""
    paused_primitive: str = ""
    """The primitive that stands on its path; empty once it goes on."""
    paused_done: float = 0.0
    """Part of the duration of that primitive that is done."""
    pending_outcome: PendingOutcome | None = None
    """The outcome after HALTING and CLOSING."""
    notes: list[ProgressNote] = []
    """Its trace, at most NOTES_KEPT entries."""
    previous: str = ""
    """The preceding command of the same client, for AFTER LAST."""
    measured: Measured | None = None
    """Values at the end of the latest primitive that REPORT asks for."""
    beside: tuple[str, ...] = ()
    """Ids of the motions of other arms that its latest job of an elaborator or a binder knows."""
    motions_seen: tuple[int, int] = (0, 0)
    """`motions_begun` and `motions_ended` when that job was created."""
    waits_for: str = ""
    """WAITING: the arm that must leave the space it needs."""
    after_test: str = ""
    """TEST: digest of the test after which it is rehearsed; empty: in the world as it is."""
    label: str = ""
    """TEST: its number in a list of sentences."""
    if_tested: str = ""
    """Digest of the test on whose strength it is given."""
    rests_on: RestsOn | None = None
    """What the elaborator must find unchanged because of `if_tested`."""

    @property
    def stands(self) -> bool:
        """Whether it is paused on the path of its motion."""
        return self.phase is Phase.EXECUTING and bool(self.primitive) and self.paused_primitive == self.primitive

    @property
    def case(self) -> int:
        """Of its script (R68); 0 before there is one."""
        return 0 if self.actions is None else self.actions.script.case

    @property
    def shown_phase(self) -> Phase:
        """Its phase for people, who see a pause on a path as a pause."""
        return Phase.PAUSED if self.stands else self.phase

    @property
    def step_words(self) -> str:
        """The current step for people, with what its start waits for."""
        waits = f" (starts when {self.starts_after} has left the space)" if self.starts_after else ""
        return self.step_text + waits

    @property
    def shown_step(self) -> str:
        return f"{self.step_words}; {path_words(self.paused_done)}" if self.stands else self.step_words


def path_words(done: float) -> str:
    """What a motion does that is paused on its path. `done`: part of its duration."""
    return f"stands on its path, {done:.0%} done"


class HaltPhase(StrEnum):
    """State of a request of a halt (`broker.decisions.halt_request`)."""

    NEW = "new"  # it is not in the state
    FORWARDED = "forwarded"  # from a socket: the subsystems in scope are halted and answer its caller
    DECLINED = "declined"  # from a socket: its scope is unknown
    AWAITING_REST = "awaiting_rest"  # a sentence: the subsystems in scope are halted, not all have confirmed rest
    SETTLED = "settled"  # a sentence: its outcome is decided, its command ends


class HaltSentence(msgspec.Struct, kw_only=True):
    """A HALT sentence that waits for rest."""

    scope: str
    """What it halts: ALL, an arm, an object or a command."""
    unconfirmed: list[str]
    """Subsystems that were ordered to halt and have not confirmed rest yet."""
    unknown: str = ""
    """The name that nothing has, for which ALL is halted."""
    settled: bool = False
    """Its outcome is decided."""


class LinkState(StrEnum):
    """Connection of a subsystem to the broker (`broker.decisions.subsystem_link`)."""

    UNKNOWN = "unknown"  # it is not in the state
    CONNECTED = "connected"
    AWAITED = "awaited"  # the broker has restarted; the subsystem continues and has not reconnected yet
    LOST = "lost"


class SubsystemState(msgspec.Struct, kw_only=True):
    """One subsystem that has connected in this run."""

    pid: int
    """Process id; a new one means that it was restarted."""
    performers: list[str]
    """Names of its arms and hands, or of its cameras."""
    queues: list[str] = []
    """Those that several commands may use at once: they serve primitives in turn."""
    link: LinkState = LinkState.CONNECTED
    """Row of its transition table."""
    came_at_rest: bool = True
    """It was at rest when it connected; False once it is lost."""
    pauses: bool = False
    """It can pause a primitive on its path."""
    rigid: bool = False
    """Its arms neither comply with a force nor turn bolts."""
    pictures: dict[str, PictureTime] = {}
    """What pictures of its cameras have taken lately."""


def queues_of(state: State) -> set[str]:
    """The performers that several commands may use at once."""
    return {name for subsystem in state.subsystems.values() for name in subsystem.queues}


def exact_arms_of(state: State) -> list[str]:
    """The arms that neither comply with a force nor turn bolts."""
    return [name for subsystem in state.subsystems.values() if subsystem.rigid for name in subsystem.performers]


def picture_times_of(state: State) -> dict[str, PictureTime]:
    """What pictures of each camera have taken lately."""
    return {name: time for subsystem in state.subsystems.values() for name, time in subsystem.pictures.items()}


class RolloutPhase(StrEnum):
    """State of the roll-out of programs for one kind of worker (`broker.decisions.program_rollout`)."""

    NONE = "none"  # it is not in the state
    PROVEN = "proven"  # the program in use has done a job, or is the first one
    TRIAL = "trial"  # the program in use is new and has not done a job yet
    ROLLED_BACK = "rolled_back"  # the newest program failed its first job; the one before is in use again


class Rollout(msgspec.Struct, kw_only=True):
    """The programs of one kind of worker. The one in use is in `State.programs`."""

    phase: RolloutPhase = RolloutPhase.NONE
    """Row of its transition table."""
    fallback: str = ""
    """Digest of the program to return to if the one on trial fails."""
    proven: list[str] = []
    """Digests of the programs that have done a job, the latest last; at most PROVEN_KEPT."""
    why: str = ""
    """Why the newest program was rolled back, in words, until the next load."""


class Result(msgspec.Struct, frozen=True, gc=False):
    """The stored result of a command that has ended."""

    message: msgspec.Raw  # encoded CommandEnded, for a client that asks again
    succeeded: bool  # for AFTER
    request: str  # its key in `State.requests`


def request_key(client: str, request: str) -> str:
    return f"{client} {request}"


class Surrender(msgspec.Struct, kw_only=True):
    """An arm that rests after a command has failed, and that the operator is asked to take (R81)."""

    arms: list[str]
    """Arms of the command."""
    cause: str
    """Why it has failed, in words."""
    sentence: str
    """Asks the operator for the same."""
    waiting: list[str] = []
    """Commands that were to follow it or to use its arms; they wait for the operator, or for RESUME."""


class Advised(msgspec.Struct):
    """What a sentence without success was advised."""

    command: str
    clears: Advice
    """By the workers."""
    left: Advice
    """What is left of that."""
    in_vain: bool
    """Whether the sentence would end so again."""
    tried: list[str]
    """Sentences of the advice that were given since."""


class State(msgspec.Struct, kw_only=True):
    """The whole state of the Decision Unit. Only `decide` changes it."""

    commands: dict[str, Command] = {}
    """Live commands by id, in order of acceptance."""
    live: dict[str, int] = {}
    """Client -> number of its live commands."""
    intake_order: dict[str, dict[str, bool]] = {}
    """Client -> {command not yet taken up: parsed?}, in order."""
    accepted: int = 0
    """Highest command number so far."""
    parsed: dict[str, msgspec.Raw] = {}
    """Digest of a parser's program and a sentence -> its ParsedCommand, of recently parsed sentences."""
    last_given: dict[str, str] = {}
    """Client -> its latest command; the most recent client is last."""
    breakpoints: list[Breakpoint] = []
    """Commands pause before these steps."""
    life: str = ""
    """Id of this journal, part of every primitive id (`rtc.protocol.primitive_id`)."""
    lost: str = ""
    """Why the journal lacks decisions, in words; empty = it is complete."""
    lost_at_s: float = 0.0
    """Time when the loss was noticed; sentences sent earlier do not start."""
    began_at_s: float = 0.0
    """Start of the cluster, not of this broker process."""
    seq: int = 0
    """Sequence number of the latest published event."""
    requests: dict[str, str] = {}
    """`request_key` -> command, live or recently ended."""
    ended: dict[str, Result] = {}
    """Results of recently ended commands, the oldest first."""
    resources: Resources = msgspec.field(default_factory=Resources)
    """Claims, waiting lines, quarantine."""
    awaiting: dict[str, list[str]] = {}
    """Command -> commands that start after its success (AFTER)."""
    joining: dict[str, list[str]] = {}
    """Command -> commands that start when it begins to move (TOGETHER-WITH)."""
    advised: dict[str, Advised] = {}
    """Sentence without success -> its advice, as long as only that is followed."""
    surrenders: dict[str, Surrender] = {}
    """Failed command -> its arms until the operator has done it, at most one for each arm."""
    answers: dict[str, OperatorAnswer] = {}
    """Command of a DONE, CANNOT or TAKE -> its answer, until that is settled."""
    subsystems: dict[str, SubsystemState] = {}
    """By name, lost ones included."""
    tested: dict[str, Tested] = {}
    """Digest -> test, the latest last."""
    motions: dict[str, ArmMotion] = {}
    """Arm -> its motion, until the world database has the result."""
    motions_begun: int = 0
    """Number of entries that `motions` has got so far."""
    spaces_mm: list[list[Box]] = []
    """The spaces of the motions begun last, at most SPACES_KEPT."""
    motions_ended: int = 0
    """Number of entries that have been removed from `motions`."""
    space_lines: dict[str, list[str]] = {}
    """Arm -> commands that wait until it leaves the space they need."""
    programs: dict[str, str] = {}
    """Worker kind (or "cell") -> digest of the program in use."""
    program_history: dict[str, list[TakenProgram]] = {}
    """Worker kind -> the programs that were taken into use, the newest last."""
    deferred_analyses: dict[str, DeferredAnalysis] = {}
    """Ended command -> its unfinished analysis."""
    rollouts: dict[str, Rollout] = {}
    """Worker kind -> the roll-out of its programs."""
    halted_at_s: dict[str, float] = {}
    """Halt scope -> time; sentences sent earlier do not start."""
    halts: dict[str, HaltPhase] = {}
    """The latest halts from sockets; a halt received twice is counted once, obeyed twice."""
    halt_sentences: dict[str, HaltSentence] = {}
    """HALT sentences that wait for rest, by the id of their command."""
    has_subscribers: bool = False
    """A client subscribes to the event stream."""
    crowded: bool = False
    """The event stream has its maximum of notes per second; see `Command.unwatched`."""
    timeout_scale: float = 1.0
    """Wall seconds per simulated second: limits of primitives are in simulated time."""
    counts: dict[str, int] = {}
    """Counters: outcomes, stale results, trims, ..."""
