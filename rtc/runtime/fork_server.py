"""Fork server (zygote): a process with imports and models loaded, which forks processes of one kind on demand.

Importing libraries and building a cell's models takes seconds of processor time; a fork takes milliseconds. So a
killed process is back at once, a large cluster starts as fast as a small one, and all share the libraries' memory.
A fork server holds neither sockets of the cluster, nor threads, nor state. If it is lost, the supervisor starts
processes directly, which takes longer. This module does not know what it forks.

Protocol: stdin is a Unix SEQPACKET socket. An order is the bytes for `become`, with file descriptors: a pipe, stdout,
stderr and optionally stdin of the new process. The answer is its pid. A double fork makes the process a child of the
supervisor, which must be a subreaper. The child then waits for one byte in the pipe, which shows that the supervisor
knows its pid and watches it. If the pipe closes before that byte (supervisor timed out or died), the child exits.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from rtc.runtime import handover, process

Become = Callable[[bytes], None]


def main(prog: str, about: str, live: Callable[[Path, int], None]) -> None:
    """The entry point of a process with one fork server: `live(run_dir, fd)`, or with --template its fork server.

    `fd`: the descriptor handed over by the supervisor (rtc.runtime.handover).
    """
    parser = argparse.ArgumentParser(prog=prog, description=about)
    parser.add_argument("--run-dir", required=True, type=Path, help="run directory of the cluster, made by `rtc up`")
    parser.add_argument("--template", action="store_true", help="be the fork server of the next such process")
    handover.add_option(parser)
    given = parser.parse_args()
    if given.template:
        serve(lambda order: live(given.run_dir, given.handed))
    else:
        live(given.run_dir, given.handed)


def serve(become: Become) -> None:
    """Print `ready`, then fork one process per order until the socket closes; each new process runs `become(order)`."""
    process.freeze_heap()  # a later collection would copy these pages in every child
    print("ready", flush=True)
    supervisor = os.getppid()
    orders = socket.socket(fileno=os.dup(0))
    while True:
        order, fds, _, _ = socket.recv_fds(orders, 4096, 4)
        if not order:
            return
        pid = _fork_away(lambda: _become(order, fds, orders, supervisor, become))  # noqa: B023
        for fd in fds:
            os.close(fd)
        orders.send(str(pid).encode())


def _fork_away(child: Callable[[], NoReturn]) -> int:
    """Double fork: a process that is not a child of this one; its pid. On return its new parent may wait for it."""
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


def _become(order: bytes, fds: list[int], orders: socket.socket, supervisor: int, become: Become) -> NoReturn:
    """Run the new process from the fork to its exit."""
    status = 1
    try:
        orders.close()
        begin, output, log, *more = fds
        if not os.read(begin, 1):
            os._exit(1)
        process.die_with_parent(supervisor)  # the parent by now: it got the pid after the adoption
        os.setsid()
        stdin = more[0] if more else os.open(os.devnull, os.O_RDONLY)
        for mine, standard in ((stdin, 0), (output, 1), (log, 2)):
            os.dup2(mine, standard)
            os.close(mine)
        os.close(begin)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.SIG_DFL)
        become(order)
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        process.leave(status)
