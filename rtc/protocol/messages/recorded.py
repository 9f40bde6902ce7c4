"""Jobs as a journal recorded them, to be repeated (R10, R101). Between the processes that `rtc replay` starts."""

from __future__ import annotations

import msgspec

from rtc.protocol.messages.shared import WorkerKind
from rtc.protocol.messages.worker import Job, JobDone, JobRefused


class RecordedJob(msgspec.Struct, frozen=True, kw_only=True):
    """A job and its answer, with the version of the world that it read."""

    kind: WorkerKind
    job: Job
    answer: JobDone | JobRefused


class RecordedJobs(msgspec.Struct, frozen=True, kw_only=True):
    """The jobs of one command, in the order of their answers. `bodies`: their programs and cells, by digest."""

    jobs: list[RecordedJob]
    bodies: dict[str, bytes]


class Repetition(msgspec.Struct, frozen=True, kw_only=True):
    """What a fresh worker made of a recorded job. `difference`: where its answer differs; empty if it is the same."""

    job: str
    kind: WorkerKind
    difference: str = ""
