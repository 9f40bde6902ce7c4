"""Workers of a load test as Ray actors: the loop of the worker runs inside the actor, without a child process.

As `benchmarks.load.worker` and `workers.runtime.start`, started by another engine, with the same local sockets: what is
compared is the engine alone. For workers of other hosts see `deploy.engines.ray_workers`.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from deploy.hypercube import addresses, kind_of
from rtc.protocol.messages import WorkerKind

START_LIMIT_S = 120.0  # an actor is a process that imports Ray


class Node:
    """The actor. `run` returns when the worker ends; it is killed before."""

    def pid(self) -> int:
        return os.getpid()

    def run(self, run_dir: str, kind: WorkerKind, node: int, busy_s: float, asleep_s: float, real: bool) -> None:
        if not real:
            from benchmarks.load.worker import work

            work(Path(run_dir), kind, node, busy_s=busy_s, asleep_s=asleep_s)
        else:
            from rtc.runtime.handover import Handover
            from rtc.runtime.settings import Settings
            from workers.runtime.preload import preload
            from workers.runtime.start import work as work_real

            settings = Settings.load(Path(run_dir))
            work_real(Handover(settings), kind, node, preload([kind], settings.cell))


@contextlib.contextmanager
def ray_workers(
    run_dir: Path, dim: int, busy_s: float, asleep_s: float, real: Sequence[WorkerKind]
) -> Iterator[dict[str, int]]:
    """Start one actor per address; yields the process ids by name. Raises ImportError if there is no Ray."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    ray: Any = importlib.import_module("ray")
    nodes = addresses(dim)
    ray.init(num_cpus=len(nodes), include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
    try:
        actor = ray.remote(num_cpus=1)(Node)
        started = {f"{kind_of(node)}@{node}": (actor.remote(), node) for node in nodes}
        limit_s = time.monotonic() + START_LIMIT_S
        pids = {
            name: ray.get(node.pid.remote(), timeout=max(1.0, limit_s - time.monotonic()))
            for name, (node, _) in started.items()
        }
        for node, address in started.values():
            kind = kind_of(address)
            node.run.remote(str(run_dir), kind, address, busy_s, asleep_s, kind in real)
        yield pids
    finally:
        ray.shutdown()
