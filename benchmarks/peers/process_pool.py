"""concurrent.futures.ProcessPoolExecutor with four processes: the answer to a job submits the next one."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor

from benchmarks.peers import chain

WINDOW = 200  # commands in progress; more do not make it faster


def measure(sizes: Sequence[int], start: Callable[[], chain.Meter]) -> None:
    stages = sizes[1:]
    payload = bytes(sizes[0])
    over = threading.Event()
    with ProcessPoolExecutor(max_workers=len(stages)) as pool:
        list(pool.map(chain.work, stages, [payload] * len(stages)))  # starts all processes

        def submit(stage: int, data: bytes) -> None:
            pool.submit(chain.work, stages[stage], data).add_done_callback(lambda done: go_on(stage, done))

        def go_on(stage: int, done: Future[bytes]) -> None:
            if over.is_set():
                return
            if stage + 1 < len(stages):
                submit(stage + 1, done.result())
            elif meter.ended():
                submit(0, payload)
            else:
                over.set()

        meter = start()
        for _ in range(WINDOW):
            submit(0, payload)
        over.wait(chain.LIMIT_S)


if __name__ == "__main__":
    chain.main(measure)
