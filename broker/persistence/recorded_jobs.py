"""The jobs of one command, from the journal: all its decisions are made again, which gives the input of each job.

`python -m broker.persistence.recorded_jobs JOURNAL C-7` writes them to stdout, as `RecordedJobs` in MessagePack.
"""

from __future__ import annotations

import sys
from pathlib import Path

from broker.decisions.decide import decide
from broker.decisions.effects import DispatchJob
from broker.decisions.events import Event, JobDeclined, JobFinished
from broker.persistence.journal import Journal
from rtc.protocol import wire
from rtc.protocol.messages import Job, JobDone, JobRefused, RecordedJob, RecordedJobs


def recorded_jobs(journal: Journal, command: str) -> RecordedJobs:
    """The answered jobs of `command` whose events the journal still has. Raises WireError for a damaged journal."""
    dispatched: dict[tuple[str, int], DispatchJob] = {}
    jobs = []
    with journal.transaction():  # one view, also while a broker writes
        after, state = journal.first_snapshot()
        for batch in journal.batches(after):
            for event in batch:
                answer = _answer_of(event, command)
                if answer and (job := dispatched.pop((answer.id, answer.attempt), None)):
                    jobs.append(_recorded(job, answer))
                for effect in decide(state, event):
                    if isinstance(effect, DispatchJob) and _belongs(effect.job, command) and not effect.doubt:
                        dispatched[effect.job, effect.attempt] = effect
        bodies = journal.programs()
    needed = {digest for recorded in jobs for digest in _bodies_of(recorded.job)}
    return RecordedJobs(jobs=jobs, bodies={name: body for name, body in bodies.items() if name in needed})


def _bodies_of(job: Job) -> list[str]:
    return [job.program, job.cell, *job.programs.values()]


def _belongs(job: str, command: str) -> bool:
    return job.partition("/")[0] == command


def _answer_of(event: Event, command: str) -> JobDone | JobRefused | None:
    match event:
        case JobFinished(job=job, attempt=attempt) if _belongs(job, command):
            return JobDone(id=job, attempt=attempt, product=event.product, took_s=event.took_s, world=event.world)
        case JobDeclined(job=job, attempt=attempt) if _belongs(job, command):
            return JobRefused(id=job, attempt=attempt, refusal=event.refusal, world=event.world)
    return None


def _recorded(job: DispatchJob, answer: JobDone | JobRefused) -> RecordedJob:
    given = Job(
        id=job.job,
        attempt=job.attempt,
        program=job.program,
        programs=job.programs,
        cell=job.cell,
        input=job.input,
    )
    return RecordedJob(kind=job.kind, job=given, answer=answer)


def main(journal: str, command: str) -> None:
    found = recorded_jobs(Journal.read_only(Path(journal)), command)
    sys.stdout.buffer.write(wire.encode(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
