"""Broker <-> workers: jobs, their results, and who is there."""

from __future__ import annotations

from typing import Annotated

import msgspec

from rtc.protocol.messages.client import Declined
from rtc.protocol.messages.shared import NODES, Heartbeat, Hello, HelloWanted, Message, Name, Shutdown, WorkerKind
from rtc.protocol.outcomes import Refusal


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
    programs: dict[str, str] = {}  # of a rehearsal, instead of `program`: kind -> digest
    cell: str = ""  # digest of the cell; empty = not needed by this kind
    input: msgspec.Raw  # ParserInput | ElaboratorInput | BinderInput | AnalyzerInput | RehearsalInput
    lease: Lease | None = None  # analyzers only
    doubt: str = ""  # not empty: only make the leased facts suspect, for this reason


class JobBatch(Message, frozen=True, kw_only=True):
    jobs: list[Job]


class CancelJobs(Message, frozen=True, kw_only=True):
    """Cancel these jobs, as far as they have not begun."""

    jobs: list[str]


class ProgramBody(Message, frozen=True, kw_only=True):
    digest: str
    body: bytes | None  # None: unknown program


class WorkerHello(Hello, frozen=True, kw_only=True):
    """A worker is ready. `node` is its address in the cube, `name` "binder@2".

    With an `instance` the gateway assigns the address and answers WorkerAddress; `node` is then the address that the
    worker had before, or None."""

    name: Name
    node: Annotated[int, msgspec.Meta(ge=0, lt=NODES)] | None
    kind: WorkerKind
    pid: int
    instance: Name = ""  # random name of this process, the same in every hello
    rehearses: bool = False  # it takes rehearsals only, "rehearser@0"; `node` is then a number outside of the cube


class WorkerAddress(Message, frozen=True, kw_only=True):
    """The address that the gateway has assigned to a worker with an `instance`."""

    name: Name
    node: Annotated[int, msgspec.Meta(ge=0, lt=NODES)]


class JobDone(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="done", gc=False):
    id: str
    attempt: int
    product: msgspec.Raw  # ParsedCommand | Script | BoundStep | Assessment | Rehearsed
    took_s: float = 0.0
    world: int = 0  # version of the world that the job read; 0 if it read none


class JobRefused(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="refused"):
    id: str
    attempt: int
    refusal: Refusal
    took_s: float = 0.0
    world: int = 0  # as in JobDone


class JobCrashed(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag="crashed"):
    """The worker function raised an exception: a bug, with its evidence. Counts like a death of the worker."""

    id: str
    attempt: int
    evidence: str  # traceback, cut to some kB


JobResult = JobDone | JobRefused | JobCrashed


class ResultBatch(Message, frozen=True, kw_only=True):
    name: str  # of the worker
    results: Annotated[list[JobResult], msgspec.Meta(max_length=1000)]


class WorkerGone(Message, frozen=True, kw_only=True):
    """A worker on another machine is gone. From the gateway if its connection is lost, or from the worker."""

    name: Name
    in_order: bool = False  # it ended as ordered: none of its jobs is the cause


class ProgramWanted(Message, frozen=True, kw_only=True):
    digest: str


WorkerToBroker = WorkerHello | Heartbeat | ResultBatch | ProgramWanted | WorkerGone
BrokerToWorker = JobBatch | CancelJobs | ProgramBody | Shutdown | WorkerAddress | Heartbeat | HelloWanted | Declined
