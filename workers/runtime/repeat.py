"""Repeat recorded jobs in a fresh process, and compare the bytes of the answers (R10, R101).

`python -m workers.runtime.repeat WORLD_DB` reads `RecordedJobs` from stdin and writes a list of `Repetition` to stdout.
It repeats each job with the program, the cell and the version of the world that the job had read. It writes nothing.
"""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from rtc.model.cells.cell import Cell
from rtc.protocol import wire
from rtc.protocol.messages import REHEARSER, JobDone, JobRefused, RecordedJob, RecordedJobs, Repetition, WorkerKind
from rtc.protocol.outcomes import Refusal, Refused
from rtc.world.store import world_at
from workers.runtime import lazy_import

WORDS = 60  # characters of a value in a difference


class Repeater:
    """Repeats jobs. `bodies`: programs and cells by digest; `world_db`: file of the world database."""

    def __init__(self, bodies: dict[str, bytes], world_db: Path) -> None:
        self._bodies = bodies
        self._world_db = world_db
        self._program = cache(lambda kind, digest: lazy_import.load(kind).compile(bodies[digest]))
        self._cell = cache(self._models)

    def repeat(self, recorded: RecordedJob) -> Repetition:
        found = difference(recorded.answer, self._answer(recorded))
        return Repetition(job=recorded.job.id, kind=recorded.kind, difference=found)

    def _answer(self, recorded: RecordedJob) -> msgspec.Raw | Refusal:
        job = recorded.job
        function: Any = lazy_import.load(REHEARSER if job.programs else recorded.kind)
        if job.programs:
            program = {kind: self._program(kind, job.programs[kind]) for kind in WorkerKind}
        else:
            program = self._program(recorded.kind, job.program)
        cell = self._cell(job.cell) if function.NEEDS_CELL and job.cell else None
        world = world_at(self._world_db, recorded.answer.world) if function.NEEDS_WORLD else None
        try:
            product = function.run(program, cell, world, wire.decoder(function.INPUT)(job.input))
        except Refused as refused:
            return refused.refusal
        return product if isinstance(product, Refusal) else wire.raw(product)

    def _models(self, digest: str) -> Any:
        module: Any = lazy_import.load("workers.planning.robot_models")
        return module.CellModel(Cell.from_bytes(self._bodies[digest]))


def difference(recorded: JobDone | JobRefused, repeated: msgspec.Raw | Refusal) -> str:
    """Where two answers differ first, in words; empty if their bytes are the same."""
    before = recorded.product if isinstance(recorded, JobDone) else wire.raw(recorded.refusal)
    after = wire.raw(repeated) if isinstance(repeated, Refusal) else repeated
    if isinstance(recorded, JobRefused) != isinstance(repeated, Refusal):
        return f"it was {'refused' if isinstance(recorded, JobRefused) else 'done'}, and is not now"
    if bytes(before) == bytes(after):
        return ""
    return _first_difference(msgspec.msgpack.decode(before), msgspec.msgpack.decode(after), "$")


def _first_difference(before: Any, after: Any, where: str) -> str:
    if isinstance(before, dict) and isinstance(after, dict) and before.keys() == after.keys():
        pairs = [(f"{where}.{key}", before[key], after[key]) for key in before]
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        pairs = [(f"{where}[{n}]", old, new) for n, (old, new) in enumerate(zip(before, after, strict=True))]
    else:
        return "" if before == after else f"{where}: {before!r:.{WORDS}} was recorded, now {after!r:.{WORDS}}"
    found = (_first_difference(old, new, place) for place, old, new in pairs)
    return next(filter(None, found), "")


def main(world_db: str) -> None:
    recorded = wire.decoder(RecordedJobs)(sys.stdin.buffer.read())
    repeater = Repeater(recorded.bodies, Path(world_db))
    sys.stdout.buffer.write(wire.encode([repeater.repeat(job) for job in recorded.jobs]))


if __name__ == "__main__":
    main(*sys.argv[1:])
