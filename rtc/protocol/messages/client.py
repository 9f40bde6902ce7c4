"""Client <-> broker: sentences, queries, programs, progress and outcomes (front.sock), and published events."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from rtc.protocol.messages.progress import Phase, ProgressNote
from rtc.protocol.messages.saved import SavedWorld
from rtc.protocol.messages.shared import (
    PROGRAM_BYTES,
    Breakpoint,
    Heartbeat,
    Hello,
    Message,
    Name,
    Shutdown,
    WorkerKind,
)
from rtc.protocol.messages.status import Status
from rtc.protocol.outcomes import NotSucceeded, Outcome, OutcomeKind, Refusal

SHOWN = 60  # characters of a sentence in `repr`

# --- client -> broker ---


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
    after_test: Name = ""  # of a TEST: digest of the test after which it is rehearsed; empty: in the world as it is
    label: Name = ""  # of a TEST: its number in a list of sentences, C-5, which later ones may name
    if_tested: Name = ""  # digest of a test that covers it; it is refused if what that rests on has changed
    saved: SavedWorld | None = None  # what SAVED means in the sentence SET WORLD FACTS SAVED


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
    reset: bool = False  # go back to a whole program of this kind; `body` is ignored
    to: Name = ""  # with `reset`: digest of a program that was in use before; empty: the default program
    cluster: Name = ""  # as in CommandText


class ProgramQuery(Message, frozen=True, kw_only=True):
    """Query the program of a kind of worker, or the cell. The answer is ProgramReply."""

    request: Name
    kind: WorkerKind | None = None  # None: the document of the cell


class SetBreakpoints(Message, frozen=True, kw_only=True):
    """Replace all breakpoints: each command pauses before these steps. The answer is Debugged."""

    request: Name
    breakpoints: Annotated[list[Breakpoint], msgspec.Meta(max_length=100)]


class StepCommand(Message, frozen=True, kw_only=True):
    """Let a command that is paused between two steps perform one of them. The answer is Debugged."""

    request: Name
    command: Name  # C-n


class ClientHello(Hello, frozen=True, kw_only=True):
    """First message of a client; its name `client` survives reconnects. The answer is Welcome."""

    client: Name
    at_s: float = 0.0  # the client's clock, from which a gateway computes the offset; 0 = unknown


# --- broker -> client ---


class Welcome(Hello, frozen=True, kw_only=True):
    cluster: str  # the run's id
    pid: int


class Accepted(Message, frozen=True, kw_only=True):
    request: str
    command: str  # C-n


class Declined(Message, frozen=True, kw_only=True):
    """The request was not accepted (not a command's outcome): unknown command, queue full, bad message.

    To any process, without a `request`: its hello is refused, because of its name or its version of the protocol."""

    request: str
    refusal: Refusal


class CommandEnded(Message, frozen=True, kw_only=True):
    seq: int
    at_s: float
    command: str
    request: str
    text: str
    outcome: Outcome
    took_s: float

    def raise_for_outcome(self) -> CommandEnded:
        """This end, if the command succeeded. Raises NotSucceeded otherwise."""
        if self.outcome.kind is not OutcomeKind.SUCCEEDED:
            raise NotSucceeded(self.command, self.text, self.outcome)
        return self

    def __repr__(self) -> str:
        text = self.text if len(self.text) <= SHOWN else f"{self.text[: SHOWN - 3]}..."
        return f"<CommandEnded {self.command} after {self.took_s:.3g} s, {self.outcome!r}: {text}>"


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
    status: Status


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
    case: int = 0  # of its script, 1 to 4 (R68); 0 before there is one
    reports: list[ProgressNote] = []  # the latest reports of EVERY and WHEN; the broker that sent them keeps some
    reports_older: int = 0  # number of those before them


class TraceReply(Message, frozen=True, kw_only=True):
    request: str
    record: CommandRecord


class Debugged(Message, frozen=True, kw_only=True):
    """The request was performed. `breakpoints`: those in force from now on."""

    request: str
    breakpoints: list[Breakpoint]


class ProgramLoaded(Message, frozen=True, kw_only=True):
    request: str
    kind: WorkerKind
    digest: str  # of the whole program
    changes: list[str] = []  # in words, one for each changed item; empty: nothing changed


class ProgramEntry(msgspec.Struct, frozen=True, kw_only=True):
    """A program that was taken into use."""

    digest: str
    file: str = ""  # name of the loaded file; empty: a default program
    age_s: float = 0.0  # since it was taken into use
    changes: list[str] = []  # in words, against the program before


class ProgramReply(Message, frozen=True, kw_only=True):
    request: str
    kind: WorkerKind | None = None  # None: the cell
    digest: str
    body: bytes  # the whole program in its canonical form, or the cell: JSON; for the parser a grammar
    history: list[ProgramEntry] = []  # programs of this kind that were taken into use, the newest first


ClientToBroker = (
    ClientHello
    | CommandText
    | StatusQuery
    | TraceQuery
    | ProgramQuery
    | ProgramText
    | SetBreakpoints
    | StepCommand
    | Shutdown
    | Heartbeat
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
    | Debugged
)
Event = ProgressNote | CommandEnded | RequestRefused | HaltRequested  # what the broker publishes
