"""What the Decision Unit wants done. Imperative; the router carries them out in order, after the journal has them."""

from __future__ import annotations

import msgspec

from rtc.messages import BrokerToClient, CommandEnded, CommandRecord, ProgressNote, WorkerKind


class Effect(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    pass


class DispatchJob(Effect, frozen=True, kw_only=True, gc=False):
    """Have one worker of this kind do this; the roster picks which."""

    job: str
    attempt: int
    kind: WorkerKind
    program: str
    cell: str
    input: msgspec.Raw
    locations: list[str] | None = None  # a lease over these goes with it


class CancelJob(Effect, frozen=True, kw_only=True, gc=False):
    job: str


class SendPrimitive(Effect, frozen=True, kw_only=True, gc=False):
    subsystem: str
    id: str
    primitive: msgspec.Raw
    issued_at_s: float
    pid: int  # of the process it is meant for: a later one would have to be told what came before


class SendHalt(Effect, frozen=True, kw_only=True, gc=False):
    subsystem: str
    halt: str
    scope: str
    called_at_s: float
    call: str = ""  # the number of the order that this passes on, or answers


class AcknowledgeReport(Effect, frozen=True, kw_only=True, gc=False):
    subsystem: str
    primitive: str


class StartTimer(Effect, frozen=True, kw_only=True, gc=False):
    """Send TimerFired(timer) at this time; a timer of the same name is replaced."""

    timer: str
    at_s: float


class StopTimer(Effect, frozen=True, kw_only=True, gc=False):
    timer: str


class TellClient(Effect, frozen=True, kw_only=True, gc=False):
    client: str
    message: BrokerToClient | msgspec.Raw  # or one that is encoded already


class PublishNote(Effect, frozen=True, kw_only=True, gc=False):
    """Progress, to whoever listens, and to the client when it asked for it (else client is empty)."""

    client: str
    note: ProgressNote


class ReportEnd(Effect, frozen=True, kw_only=True, gc=False):
    """A command has ended: tell its client, tell the listeners, archive its story."""

    client: str
    ended: CommandEnded
    record: CommandRecord


class DeclineHalt(Effect, frozen=True, kw_only=True, gc=False):
    """A halt whose scope is nothing known: say so to the caller."""

    client: str
    halt: str
    message: str


AnyEffect = (
    DispatchJob
    | CancelJob
    | SendPrimitive
    | SendHalt
    | AcknowledgeReport
    | StartTimer
    | StopTimer
    | TellClient
    | PublishNote
    | ReportEnd
    | DeclineHalt
)
