"""Celery with four prefork processes, Redis as broker and for the results: `chain` of four tasks.

The Celery worker imports this module too; the environment variable `SOCKET` names the socket of its Redis.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from benchmarks.peers import chain
from rtc.runtime.process import die_with_parent

WINDOW = 100  # commands in progress
SOCKET = "BENCH_REDIS"  # environment variable with the path of the socket
START_S = 30.0
PROCESSES = 4


def application(socket: str) -> Any:
    """The Celery application and its task, for both ends."""
    celery: Any = importlib.import_module("celery")
    made = celery.Celery("chain", broker=f"redis+socket://{socket}", backend=f"redis+socket://{socket}")
    made.conf.update(task_ignore_result=False, broker_connection_retry_on_startup=True)

    @made.task(name="work")
    def work(payload: str, size: int) -> str:
        return chain.work(size, payload.encode()).replace(b"\0", b"x").decode()

    return made


def measure(sizes: Sequence[int], start: Callable[[], chain.Meter]) -> None:
    celery: Any = importlib.import_module("celery")
    if shutil.which("redis-server") is None:
        raise chain.Missing("no redis-server here")
    with (
        tempfile.TemporaryDirectory(prefix="rtc-bench-") as folder,
        _processes(folder) as socket,
        application(socket) as app,
    ):
        work = app.tasks["work"]
        first, *others = sizes[1:]

        def submit() -> Any:
            signatures = [work.s("x" * sizes[0], first), *(work.s(size) for size in others)]
            return celery.chain(*signatures).apply_async()

        submit().get(timeout=START_S)
        under_way = deque(submit() for _ in range(WINDOW))
        meter = start()
        while True:
            under_way.popleft().get(timeout=START_S)
            if not meter.ended():
                break
            under_way.append(submit())
        app.backend.result_consumer.stop()  # otherwise it tries to reach its Redis for a long time
        under_way.clear()


@contextlib.contextmanager
def _processes(folder: str) -> Iterator[str]:
    """A Redis and a Celery worker of our own; the socket of the Redis."""
    me, socket = os.getpid(), f"{folder}/redis.sock"
    redis = ["redis-server", "--port", "0", "--unixsocket", socket, "--save", "", "--dir", folder]
    worker = [sys.executable, "-m", "celery", "-A", "benchmarks.peers.celery_redis:app", "worker"]
    worker += ["--concurrency", str(PROCESSES), "--loglevel", "ERROR", "--without-gossip", "--without-mingle"]
    running = []
    try:
        for command in (redis, worker):
            running.append(
                subprocess.Popen(
                    command,
                    env=os.environ | {SOCKET: socket, "C_FORCE_ROOT": "1"},
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    preexec_fn=lambda: die_with_parent(me),
                    start_new_session=True,
                )
            )
            end_s = time.monotonic() + START_S
            while not os.path.exists(socket) and time.monotonic() < end_s:
                time.sleep(0.01)
        yield socket
    finally:
        for process in reversed(running):
            os.killpg(process.pid, signal.SIGKILL)  # and the processes that it has forked
            process.wait()


if __name__ == "__main__":
    chain.main(measure)
elif SOCKET in os.environ:
    app = application(os.environ[SOCKET])
