"""Ray with four actors on two cores: each actor gets the reference of the previous result."""

from __future__ import annotations

import importlib
import logging
import os
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.peers import chain

WINDOW = 200  # commands in progress
CORES = 2


def measure(sizes: Sequence[int], start: Callable[[], chain.Meter]) -> None:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    ray: Any = importlib.import_module("ray")
    ray.init(num_cpus=CORES, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
    try:

        @ray.remote(num_cpus=CORES / len(sizes[1:]))
        class Worker:
            def __init__(self, size: int) -> None:
                self.size = size

            def work(self, payload: bytes) -> bytes:
                return chain.work(self.size, payload)

        actor: Any = Worker
        workers = [actor.remote(size) for size in sizes[1:]]
        payload = bytes(sizes[0])

        def submit() -> Any:
            result: Any = payload
            for worker in workers:
                result = worker.work.remote(result)
            return result

        ray.get(submit())
        under_way = deque(submit() for _ in range(WINDOW))
        meter = start()
        while True:
            ray.get(under_way.popleft())  # they end in the order of their start
            if not meter.ended():
                break
            under_way.append(submit())
    finally:
        ray.shutdown()


if __name__ == "__main__":
    chain.main(measure)
