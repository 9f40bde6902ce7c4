"""The template of all workers: one process that has imported and built what every kind needs, and forks on demand.

Importing the robot libraries and building a cell's models costs seconds of processor time, a fork milliseconds. So a
cluster of many workers starts as quickly as one of few, a killed worker is back at once, and all share the libraries'
memory. It holds no socket of the cluster, no thread and no state: losing it costs nothing but time (the supervisor then
starts workers by themselves).

Orders come on stdin, a Unix socket of whole messages: {"kind", "node"} with two file descriptors, the worker's stdout
and stderr; the answer is the worker's pid. The worker becomes a child of whoever started the template, who must be a
subreaper: it is forked twice, and the one between ends at once.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import msgspec

from rtc import process
from rtc.messages import WorkerKind
from workers.warm import Warm, warm

ADOPTION_LIMIT_S = 5.0

Work = Callable[[Path, WorkerKind, int, Warm], None]


class Order(msgspec.Struct, frozen=True):
    kind: WorkerKind
    node: int


def serve(run_dir: Path, work: Work, prepare: Callable[[Path], Warm] = warm) -> None:
    """Prepare, say ready, then fork as ordered, until the other end is closed."""
    process.log_to_stderr()
    prepared = prepare(run_dir)
    process.freeze_heap()  # what is collected later would be copied in every worker
    print("ready", flush=True)
    supervisor = os.getppid()
    orders = socket.socket(fileno=os.dup(0))
    while True:
        message, fds, _, _ = socket.recv_fds(orders, 4096, 2)
        if not message:
            return
        order = msgspec.json.decode(message, type=Order)

        def be_worker() -> None:
            work(run_dir, order.kind, order.node, prepared)  # noqa: B023

        pid = _fork_away(lambda: _become(order, fds, orders, supervisor, be_worker))  # noqa: B023
        for fd in fds:
            os.close(fd)
        orders.send(str(pid).encode())


def _fork_away(child: Callable[[], NoReturn]) -> int:
    """Fork a process that is not our child; its pid. It may be waited for by its new parent when this returns."""
    read, write = os.pipe()
    between = os.fork()
    if between == 0:
        pid = os.fork()
        if pid == 0:
            os.close(read)
            os.close(write)
            child()
        os.write(write, str(pid).encode())
        os._exit(0)
    os.close(write)
    pid = int(os.read(read, 32))
    os.close(read)
    os.waitpid(between, 0)
    return pid


def _become(
    order: Order, fds: list[int], orders: socket.socket, supervisor: int, be_worker: Callable[[], None]
) -> NoReturn:
    """The worker's life, from a fork of the template to its end."""
    status = 1
    try:
        orders.close()
        os.setsid()
        null = os.open(os.devnull, os.O_RDONLY)
        for mine, standard in ((null, 0), (fds[0], 1), (fds[1], 2)):
            os.dup2(mine, standard)
            os.close(mine)
        _await_adoption(supervisor)
        process.die_with_parent(supervisor)
        process.show_name(f"{order.kind}@{order.node}")
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.SIG_DFL)
        be_worker()
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)  # not the template's clean-up


def _await_adoption(supervisor: int) -> None:
    """The one between us and the template ends within a millisecond; then we are the supervisor's."""
    end = time.monotonic() + ADOPTION_LIMIT_S
    while os.getppid() != supervisor:
        if time.monotonic() > end:
            raise OSError(f"not adopted by the supervisor (pid {supervisor})")
        time.sleep(0.0002)
