"""Supervisor and gateway <-> broker: processes of the cluster, and peers on other machines."""

from __future__ import annotations

from typing import Annotated

import msgspec

from rtc.protocol.messages.client import Declined
from rtc.protocol.messages.shared import Hello, Message, Name, Shutdown, UnreadableMessages, WorkerKind
from rtc.protocol.messages.status import ProcessRow


class ProcessHello(Hello, frozen=True, kw_only=True):
    """The supervisor, the world database or the gateway is connected. The supervisor expects the broker's orders."""

    name: Name


class ProcessExited(Message, frozen=True, kw_only=True):
    """A process of the cluster has ended."""

    name: Name  # "binder@2", "MCM", "world"
    pid: int
    status: int  # as from waitpid: negative = signal
    called: str = ""  # the last code of an installed package that it has announced to call


class WorkerRequest(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The latest run of the command line for more workers of a kind (`rtc up --more`)."""

    kind: WorkerKind
    count: int
    registered_before: int  # workers of this kind on other machines at that time
    at_s: float  # CLOCK_MONOTONIC
    running: bool = False
    failed: str = ""  # why it failed, in words; empty = it succeeded or is running
    output: Name = ""  # its last line


class ProcessTable(Message, frozen=True, kw_only=True):
    """All processes of the cluster, for `rtc status`."""

    processes: Annotated[list[ProcessRow], msgspec.Meta(max_length=10_000)]
    asked: Annotated[list[WorkerRequest], msgspec.Meta(max_length=100)] = []


class RemoteWorker(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
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
    workers: list[RemoteWorker] = []
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
    rehearses: bool = False  # a rehearser instead of a worker of this kind


class RetireWorker(Message, frozen=True, kw_only=True):
    name: str


class RequestWorkers(Message, frozen=True, kw_only=True):
    """Run the user's command line for more workers on other machines, unless it runs already."""

    kind: WorkerKind
    count: int
    registered_before: int  # workers of this kind on other machines


# ProcessHello, UnreadableMessages, GatewayReport: also from other processes
SupervisorToBroker = ProcessHello | ProcessExited | ProcessTable | Shutdown | UnreadableMessages | GatewayReport
BrokerToSupervisor = KillProcess | SpawnWorker | RetireWorker | RequestWorkers | Shutdown | AllEnded | Declined
