"""The status of a cluster: the answer to StatusQuery.

`rtc status --json` prints it, so its keys are a promise to users; all of them are always present. `docs/protocol.md`
explains them. `_ago_s` and `age_s` are seconds before the answer.
"""

from __future__ import annotations

import msgspec

from rtc.protocol.messages.progress import Phase
from rtc.protocol.messages.shared import Breakpoint, Name


class StatusPart(msgspec.Struct, frozen=True, kw_only=True):
    """Base of the status and its rows: keys with default values are sent too."""


class ProcessRow(StatusPart, frozen=True, kw_only=True):
    """A process as the supervisor knows it."""

    name: Name
    pid: int = 0  # 0 = it does not run
    state: Name = ""
    restarts: int = 0
    since_s: float = 0.0  # CLOCK_MONOTONIC: start of this state
    node: int | None = None  # cube address of a worker
    notes: list[str] = []  # warnings: a database set aside, the last output of a crash loop


class WorkerRow(StatusPart, frozen=True, kw_only=True):
    name: str = ""
    node: int = 0
    kind: str = ""  # a WorkerKind or REHEARSER
    pid: int = 0
    abilities: list[str] = []
    busy_with: str = ""  # a job, C-7/3
    queued: int = 0
    done: int = 0
    mean_ms: float | None = None


class HostRow(StatusPart, frozen=True, kw_only=True):
    """A key on one host. `asked` and `missing` are of the key on all its hosts."""

    host: str = ""
    key: str = ""
    role: str = ""
    asked: int = 0
    joined: int = 0
    missing: int = 0
    workers: list[str] = []
    state: str = ""  # of the link, in words
    refused: int = 0
    late_results: int = 0
    lost: dict[str, float] = {}  # worker -> age of the loss (s)
    connections: int = 0
    refusal: str = ""
    refused_ago_s: float | None = None
    round_trip_ms: float | None = None
    round_trip_ago_s: float | None = None
    last_message_ago_s: float | None = None


class MoreWorkersRow(StatusPart, frozen=True, kw_only=True):
    """The latest request of a kind by `rtc up --more`."""

    kind: str
    asked: int
    joined: int = 0
    ago_s: float = 0.0
    running: bool = False
    failed: str = ""
    output: str = ""


class RefusedPeerRow(StatusPart, frozen=True, kw_only=True):
    """A peer that speaks another version of the protocol, or that no cell names."""

    name: str
    socket: str
    protocol: int
    message: str
    ago_s: float


class ResourceRow(StatusPart, frozen=True, kw_only=True):
    name: str
    owner: str = ""  # for people: the commands of `owners`, or what `quarantine` waits for
    owners: list[str] = []
    quarantine: str = ""  # the subsystem that must confirm rest, or "the world database"; empty: it is not closed
    exclusive: bool = False
    waiting: list[str] = []


class CommandRow(StatusPart, frozen=True, kw_only=True):
    command: str
    text: str = ""
    phase: Phase = Phase.PARSING
    step: str = ""
    resources: list[str] = []  # that it alone has
    age_s: float = 0.0


class MotionRow(StatusPart, frozen=True, kw_only=True):
    """The motion of an arm: knots of its path, joined by quintic Hermite polynomials (s, rad; m for slides)."""

    arm: str
    command: str
    primitive: str
    started_ago_s: float | None = None
    time_s: list[float] = []
    positions: list[list[float]] = []
    velocities: list[list[float]] = []
    accelerations: list[list[float]] = []


class SubsystemRow(StatusPart, frozen=True, kw_only=True):
    name: str
    state: str = ""
    pid: int = 0
    performers: list[str] = []
    executing: list[str] = []  # primitives
    injected: list[str] = []  # faults of a simulation, in words
    strayed: list[str] = []  # arms that moved without a primitive, and how


class SurrenderRow(StatusPart, frozen=True, kw_only=True):
    """A failed command that the operator is asked to do."""

    command: str
    arms: list[str]
    cause: str
    sentence: str
    waiting: list[str]


class HaltCount(StatusPart, frozen=True, kw_only=True):
    called: int = 0  # at halt sockets, each halt once


class ProgramFile(StatusPart, frozen=True, kw_only=True):
    file: str
    age_s: float = 0.0


class Status(StatusPart, frozen=True, kw_only=True):
    cluster: str = ""
    run_dir: str = ""
    protocol: int = 0
    refused: list[RefusedPeerRow] = []
    uptime_s: float = 0.0
    broker_uptime_s: float = 0.0
    seq: int = 0
    processes: list[ProcessRow] = []
    supervisor_silent_s: float = 0.0
    workers: list[WorkerRow] = []
    hosts: list[HostRow] = []
    asked_for: list[MoreWorkersRow] = []
    gateway_silent_s: float = 0.0
    queues: dict[str, int] = {}
    resources: list[ResourceRow] = []
    commands: list[CommandRow] = []
    commands_live: int = 0
    motions: list[MotionRow] = []
    commands_accepted: int = 0
    subsystems: list[SubsystemRow] = []
    surrenders: list[SurrenderRow] = []
    breakpoints: list[Breakpoint] = []
    halts: HaltCount = HaltCount()
    counters: dict[str, int] = {}
    decision_ms: dict[str, float] = {}  # p50, p99, max; empty before the first decision
    programs: dict[str, str] = {}  # kind -> digest
    program_files: dict[str, ProgramFile] = {}
    rolled_back: dict[str, str] = {}
