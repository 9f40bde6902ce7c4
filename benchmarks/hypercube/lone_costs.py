"""Times the processes of a cluster with one command in progress: each message finds its receiver asleep.

A process that has slept needs more processor time for a message than one that has just worked. Nothing waits here, so
these figures say nothing of the throughput. The cluster has one worker of each kind.
"""

from __future__ import annotations

import os
from typing import Any

from benchmarks.hypercube.fit import quantiles
from benchmarks.hypercube.process_costs import KINDS, used_s
from benchmarks.load.client import LoadClient
from benchmarks.load.cluster import Running, cluster
from benchmarks.load.trivial import sentence
from benchmarks.load.verdict import JournalReader
from benchmarks.throughput import PLANNERS, motion
from broker.decisions.events import JobFinished

WARM_UP_S = 1.0
DURATION_S = 4.0
WORKLOADS = {"trivial": (sentence, ()), "real": (motion, PLANNERS)}


def measure() -> dict[str, Any]:
    """By workload: commands ended; processor time per command of each process, (main, I/O) in s; durations of jobs."""
    return {name: run(name) for name in WORKLOADS}


def run(workload: str) -> dict[str, Any]:
    text, real = WORKLOADS[workload]
    times: dict[str, list[float]] = {kind: [] for kind in KINDS}
    with cluster(2, real=real) as running, LoadClient(running.settings, text, window=1) as client:
        client.run(WARM_UP_S)
        client.drain()
        journal = JournalReader(running.run_dir)
        journal.read()
        client.outcomes.clear()
        before = _used_s(running)
        client.run(DURATION_S)
        client.drain()
        after = _used_s(running)
        for event in journal.read():
            if isinstance(event, JobFinished):
                times[event.node.partition("@")[0]].append(event.took_s)
        journal.close()
    ended = client.outcomes.total()
    per_command = {
        name: [(now - then) / ended for now, then in zip(after[name], before[name], strict=True)] for name in after
    }
    return {
        "commands": ended,
        "per_command": per_command,
        "service": {kind: quantiles(values) for kind, values in times.items()},
    }


def _used_s(running: Running) -> dict[str, tuple[float, float]]:
    """Processor time so far (s) of each process, and of this one, the client: main thread, I/O thread."""
    used = {name.partition("@")[0]: used_s(process.pid) for name, process in running.processes.items()}
    return {**used, "client": used_s(os.getpid())}
