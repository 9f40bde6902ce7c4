"""Effects: the output of the Decision Unit, in the imperative. The router executes them after the journal write.

They are executed in order.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from rtc.protocol.messages import (
    BrokerToClient,
    CommandEnded,
    CommandRecord,
    HaltOrder,
    HaltRequested,
    OperatorAnswer,
    ProgressNote,
    WorkerKind,
)


class Effect(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    pass


class DispatchJob(Effect, frozen=True, kw_only=True, gc=False):
    """Assign a job to one worker of this kind; the worker registry selects it."""

    job: str
    attempt: int
    kind: WorkerKind
    queue: str  # it waits in: its kind, or REHEARSER with the `programs` of all kinds
    program: str
    cell: str
    input: msgspec.Raw
    locations: tuple[str, ...] | None = None  # names in the lease that is sent with the job
    client: str = ""  # client of its command: the jobs of all clients are assigned in turn
    programs: dict[str, str] = {}
    doubt: str = ""  # why the facts of `locations` become suspect, instead of an analysis


class LoadPart(Effect, frozen=True, kw_only=True, gc=False):
    """Load a part of the delivered programs (LOAD name INTO kind). The answer is that of a job: its product is a script
    without steps, whose notes are the changes."""

    job: str
    attempt: int
    kind: WorkerKind
    name: str  # of the part, as the sentence has it


class CancelJob(Effect, frozen=True, kw_only=True, gc=False):
    job: str


class SendPrimitive(Effect, frozen=True, kw_only=True, gc=False):
    subsystem: str
    id: str
    primitive: msgspec.Raw
    pid: int  # process id of the addressee: a restarted subsystem must not receive it


class SendPace(Effect, frozen=True, kw_only=True, gc=False):
    """Pause a primitive on its path, or let it go on."""

    subsystem: str
    primitive: str
    paused: bool


class SendAnswer(Effect, frozen=True, kw_only=True, gc=False):
    """Pass an answer of the operator on."""

    subsystem: str
    answer: OperatorAnswer


class SendHalt(Effect, frozen=True, kw_only=True, gc=False):
    subsystem: str
    order: HaltOrder


class AcknowledgeReport(Effect, frozen=True, kw_only=True, gc=False):
    subsystem: str
    primitive: str


class StartTimer(Effect, frozen=True, kw_only=True, gc=False):
    """Send TimerFired(timer) at this time; a timer of the same name is replaced. It fires later if one of `subsystems`
    is slower than our clock: their own time counts too."""

    timer: str
    at_s: float
    subsystems: Sequence[str] = ()


class StopTimer(Effect, frozen=True, kw_only=True, gc=False):
    timer: str


class TellClient(Effect, frozen=True, kw_only=True, gc=False):
    client: str
    message: BrokerToClient | msgspec.Raw  # Raw: already encoded


class PublishNote(Effect, frozen=True, kw_only=True, gc=False):
    """Publish a progress note, and send it to the client if it wants notes (otherwise `client` is empty)."""

    client: str
    note: ProgressNote


class ReportEnd(Effect, frozen=True, kw_only=True, gc=False):
    """Report the end of a command to its client and to subscribers, and archive its record."""

    client: str
    ended: CommandEnded
    record: CommandRecord


class DeclineHalt(Effect, frozen=True, kw_only=True, gc=False):
    """Reply to the caller of a halt that its scope is unknown."""

    client: str
    halt: str
    message: str


class PublishHalt(Effect, frozen=True, kw_only=True, gc=False):
    """Publish a halt that is not a sentence."""

    halt: HaltRequested
