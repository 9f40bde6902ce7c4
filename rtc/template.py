"""A template: one process that has imported and built what a kind of process needs, and forks such processes on demand.

Importing libraries and building a cell's models costs seconds of processor time, a fork milliseconds. So a killed
process is back at once, a cluster of many workers starts as quickly as one of few, and all share the libraries' memory.
A template holds no socket of the cluster, no thread and no state: losing it costs nothing but time (the supervisor then
starts processes by themselves). This file does not know what it forks.

Orders come on stdin, a Unix socket of whole messages: bytes for `be`, with the file descriptors of a pipe and of the
new process's stdout and stderr (and stdin, if it is to have one); the answer is its pid. The process becomes a child of
whoever started the template, who must be a subreaper: it is forked twice, and the one between ends at once. Then it
waits for one byte in the pipe: whoever ordered it knows it now, and watches it. When the pipe ends without, because the
answer came too late or he is dead, it ends too. The order TWIN makes another template: two that are forked from each
other need never be made anew.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import traceback
from collections.abc import Callable
from typing import NoReturn

from rtc import process

TWIN = b"twin"

Be = Callable[[bytes], None]


def serve(be: Be) -> None:
    """Say ready, then fork as ordered, until the other end is closed: each new process lives by `be(order)`."""
    process.freeze_heap()  # what is collected later would be copied in every process
    print("ready", flush=True)
    supervisor = os.getppid()
    orders = socket.socket(fileno=os.dup(0))
    while True:
        order, fds, _, _ = socket.recv_fds(orders, 4096, 4)
        if not order:
            return
        pid = _fork_away(lambda: _become(order, fds, orders, supervisor, be))  # noqa: B023
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


def _become(order: bytes, fds: list[int], orders: socket.socket, supervisor: int, be: Be) -> NoReturn:
    """The life of a process, from the fork to its end."""
    status = 1
    try:
        orders.close()
        begin, output, log, *more = fds
        if not os.read(begin, 1):
            os._exit(1)
        process.die_with_parent(supervisor)  # ours by now: it has had the answer that was given after the adoption
        os.setsid()
        stdin = more[0] if more else os.open(os.devnull, os.O_RDONLY)
        for mine, standard in ((stdin, 0), (output, 1), (log, 2)):
            os.dup2(mine, standard)
            os.close(mine)
        os.close(begin)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.SIG_DFL)
        if order == TWIN:
            serve(be)
        else:
            be(order)
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(OSError):  # a full disk
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)  # not the template's clean-up
