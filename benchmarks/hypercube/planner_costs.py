"""Times the real parser, elaborator and binder alone, one process each, in the conditions of a cell with two arms.

A binder needs more time beside a motion of the other arm. It needs still more if it cannot use the way of the
elaborator, because the other arm did something else then. Each worker always has one job ahead, as with a busy broker.
A job's cost is processor time: of the worker, and of the world database for it. The model
(`benchmarks.hypercube.model`) finds out how often each condition occurs.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from statistics import median
from typing import Any

from benchmarks.hypercube.fit import quantiles
from benchmarks.hypercube.motions import ARMS, Motions
from benchmarks.hypercube.process_costs import KINDS, Jobs, Peer, peer, stream, used_s
from benchmarks.throughput import MOTIONS, PLANNERS
from rtc.programs import loader
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.digest import digest
from rtc.protocol.messages import WorkerKind
from rtc.runtime.process import die_with_parent

BLOCKS = 7  # the median of so many blocks is taken
LONGER = 2.0  # times the median: a job that took longer was preempted
SETTLING = 20  # jobs before the first block


def conditions(motions: Motions) -> dict[WorkerKind, dict[str, list[Any]]]:
    """By kind and condition: an input for each arm. The names of the conditions are known to the model."""
    arms = range(ARMS)
    return {
        WorkerKind.PARSER: {"alone": [m.ParserInput(text=text) for text in MOTIONS]},
        WorkerKind.ELABORATOR: {
            "alone": [motions.elaborator_input(n) for n in arms],
            "beside": [motions.elaborator_input(n, beside=True) for n in arms],
        },
        WorkerKind.BINDER: {
            "alone": [motions.binder_input(n) for n in arms],
            "alone, new way": [motions.binder_input(n, known=False) for n in arms],
            "beside": [motions.binder_input(n, beside=True) for n in arms],
            "beside, new way": [motions.binder_input(n, beside=True, known=False) for n in arms],
        },
    }


def measure(repetitions: int) -> dict[str, Any]:
    """By kind and condition: processor time per job (s) of the worker's main and I/O thread and of the world database,
    and the durations of the jobs."""
    motions = Motions()
    inputs = conditions(motions)
    return {kind.value: planner(kind, inputs[kind], motions, repetitions) for kind in PLANNERS}


def planner(kind: WorkerKind, inputs: dict[str, list[Any]], motions: Motions, repetitions: int) -> dict[str, Any]:
    """The costs of one kind. The conditions alternate, so that a busy machine affects all."""
    program, cell = digest(loader.default(kind)), digest(motions.cell.encode())
    command = ["-m", "workers", "--kind", kind.value, "--node", str(KINDS.index(kind))]
    found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in inputs}
    took_s: dict[str, list[float]] = {name: [] for name in inputs}
    read = wire.reader(m.WorkerToBroker)
    with peer("workers", *command) as process, _world(process) as world:
        jobs = {name: Jobs(program, cell, [wire.raw(data) for data in some]) for name, some in inputs.items()}
        for block in range(BLOCKS + 1):
            for name in inputs:
                before = (*process.used_s(), sum(used_s(world)))
                durations_s = stream(read, process, jobs[name], repetitions if block else SETTLING)
                after = (*process.used_s(), sum(used_s(world)))
                if block:
                    took_s[name] += durations_s
                    found[name].append(tuple((b - a) / repetitions for a, b in zip(before, after, strict=True)))  # type: ignore[arg-type]
    return {
        name: {
            **{of: median(values) for of, values in zip(("main", "io", "world"), zip(*rows, strict=True), strict=True)},
            "service": _undisturbed(quantiles(took_s[name])),
        }
        for name, rows in found.items()
    }


def _undisturbed(took_s: list[float]) -> list[float]:
    """The durations without waits for a core: jobs of one condition differ by less than LONGER."""
    most_s = LONGER * median(took_s)
    return [min(each, most_s) for each in took_s]


@contextmanager
def _world(process: Peer) -> Iterator[int]:
    """The world database of this peer's cluster; its process id."""
    me = os.getpid()
    database = subprocess.Popen(
        [sys.executable, "-m", "rtc.world", "--run-dir", process.settings.run_dir],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: die_with_parent(me),
    )
    try:
        assert database.stdout is not None
        database.stdout.readline()  # it is ready
        yield database.pid
    finally:
        database.kill()
        database.wait()
