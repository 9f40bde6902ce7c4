"""One child process of the supervisor: start, output, health and exit. It decides nothing.

A process starts by its command or, if its spec names a fork server that is ready, by a fork of that server.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
from collections import deque
from collections.abc import Container, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import BinaryIO

from deploy.restarts import Death
from rtc.runtime.process import ALIVE, CALLS, NOTE, READY, die_with_parent, now_s, usage

LOG_LIMIT = 10 << 20  # bytes; a longer log is copied to NAME.log.1 and truncated
REMEMBERED_DEATHS = 100  # maximum number of recorded deaths
NOTES_KEPT = 5  # maximum number of kept notes
FORK_LIMIT_S = 1.0  # limit for the answer of a fork server, which takes milliseconds; it begins anew ...
FORK_TRIES = 10  # ... so often, if the fork server uses the processor: the machine is busy


@dataclass(frozen=True)
class Spec:
    """The specification of a process. The process must write the line `ready` to its stdout."""

    name: str
    command: tuple[str, ...]
    node: int | None = None  # address of a worker
    is_fork_server: bool = False  # it is a fork server: its stdin is a socket for orders
    beats: bool = False  # its loop writes `alive` every second; without that it is hung
    fork_server: str = ""  # name of the fork server of this process, if any; it waits for that one
    order: bytes = b""  # order that makes the fork server fork it
    fds: tuple[int, ...] = ()  # file descriptors that it inherits


class ProcessState(StrEnum):
    """The state of a process, as `rtc status` shows it."""

    PENDING = "pending"  # for its first start
    STARTING = "starting"
    READY = "ready"
    WAITING = "restarting"  # for its next start
    LOOPING = "crash loop"  # waiting with a delay, after several deaths soon after the start
    FAILED = "failed"  # not restarted any more
    ENDING = "ending"  # SIGTERM sent
    ENDED = "ended"


_WAITS = frozenset({ProcessState.PENDING, ProcessState.WAITING, ProcessState.LOOPING})
_AFTER_A_DEATH = frozenset({ProcessState.WAITING, ProcessState.LOOPING, ProcessState.FAILED})
#: what may follow what; only a process that runs is ended, and a failed or ended one stays so
FOLLOWS: Mapping[ProcessState, frozenset[ProcessState]] = {
    **dict.fromkeys(_WAITS, _AFTER_A_DEATH | {ProcessState.STARTING}),  # or it cannot be started
    ProcessState.STARTING: _AFTER_A_DEATH | {ProcessState.READY, ProcessState.ENDING},
    ProcessState.READY: _AFTER_A_DEATH | {ProcessState.ENDING},
    ProcessState.ENDING: frozenset({ProcessState.ENDING, ProcessState.ENDED}),
    ProcessState.FAILED: frozenset(),
    ProcessState.ENDED: frozenset(),
}


class ForkConnection:
    """The supervisor's end of the socket to a fork server: an order, its answer, and a start byte for the child."""

    def __init__(self) -> None:
        self.pid = 0  # of the fork server
        self._ours, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)  # whole messages
        self._ours.settimeout(FORK_LIMIT_S)

    def fork(self, order: bytes, *fds: int) -> tuple[int, int]:
        """(pid, pidfd) of a new child process; `fds`: its stdout, stderr and, optionally, stdin.

        The child waits for a start byte on a pipe. If the pipe closes first (late answer, dead supervisor), it exits,
        so that no process runs unwatched. Raises OSError without an answer in time, and for each later call.
        """
        begin, start = os.pipe()
        try:
            socket.send_fds(self._ours, [order], [begin, *fds])
            answer = self._answer()
            if not answer:
                raise ConnectionError("the fork server has ended")
            pid = int(answer)
            pidfd = os.pidfd_open(pid)
            os.write(start, b"!")
            return pid, pidfd
        except OSError:
            self.close()  # a late answer must not count for the next order
            raise
        finally:
            os.close(begin)
            os.close(start)

    def _answer(self) -> bytes:
        for _ in range(FORK_TRIES):
            before = usage(self.pid)
            with contextlib.suppress(TimeoutError):
                return self._ours.recv(32)
            if usage(self.pid) == before:
                break
        raise TimeoutError("no answer in time")

    def close(self) -> None:
        self._ours.close()


class Child:
    """A process. `exited_fd` becomes readable when it ends, `output_fd` when it writes to stdout."""

    def __init__(self, spec: Spec, log: Path) -> None:
        self.spec = spec
        self.log = log
        self.state = ProcessState.PENDING
        self.since_s = now_s()
        self.last_output_s = 0.0  # time of its last output
        self.busy_s = 0.0  # time of its last observed use of the processor
        self.worked_s = 0.0  # processor time since its last output or change of state
        self.stopped_since_s = 0.0  # stopped by a signal since then; 0 = not stopped
        self.restarts = 0
        self.called = ""  # the last code of a package that it has announced to call
        self.notes: deque[str] = deque(maxlen=NOTES_KEPT)  # its last notes for people, over all restarts
        self._news: list[str] = []  # notes not yet returned by take_news
        self.was_ready = False  # before any of its restarts
        self.deaths: deque[Death] = deque(maxlen=REMEMBERED_DEATHS)
        self.start_at_s = 0.0  # start time while it `waits`
        self.kill_at_s = 0.0  # time of SIGKILL while ENDING
        self.exited_fd = self.output_fd = -1
        self.line: ForkConnection | None = None  # of a fork server
        self.pid = 0  # 0 = none
        self._popen: subprocess.Popen[bytes] | None = None  # None if it was forked by a fork server
        self.output_over = False  # its stdout is closed
        self._line = b""
        self._total_s = 0.0  # processor time at the last look

    @property
    def waits(self) -> bool:
        """True while it waits for its next start."""
        return self.state in _WAITS

    def become(self, state: ProcessState) -> None:
        """Changes its state. Raises ValueError for a change that `FOLLOWS` does not have."""
        if state not in FOLLOWS[self.state]:
            raise ValueError(f"{self.spec.name} is {self.state}: it does not become {state}")
        self.state, self.since_s, self.worked_s = state, now_s(), 0.0

    def start(self, fork_server: ForkConnection | None = None) -> None:
        """Starts it by its command or by `fork_server`; stderr goes to the log. Raises OSError."""
        limit_log(self.log)
        self.output_fd, output = os.pipe()
        self.line = ForkConnection() if self.spec.is_fork_server else None
        stdin = (self.line.theirs.fileno(),) if self.line else ()
        try:
            with open_log(self.log) as log:
                if fork_server is None:
                    self._popen = self._run(output, log.fileno(), *stdin)
                    self.pid, self.exited_fd = self._popen.pid, os.pidfd_open(self._popen.pid)
                else:
                    self.pid, self.exited_fd = fork_server.fork(self.spec.order, output, log.fileno(), *stdin)
        except OSError:
            if self._popen is not None:  # a process without a watcher must not run
                self._popen.kill()
                self._popen.wait()
                self._popen = None
            os.close(self.output_fd)
            if self.line:
                self.line.close()
            raise
        finally:
            os.close(output)
            if self.line:
                self.line.theirs.close()  # so that its death closes the connection
        os.set_blocking(self.output_fd, False)
        if self.line:
            self.line.pid = self.pid
        self._line, self.output_over, self._total_s, self.called = b"", False, 0.0, ""
        self.become(ProcessState.STARTING)

    def _run(self, output: int, log: int, stdin: int = subprocess.DEVNULL) -> subprocess.Popen[bytes]:
        me = os.getpid()
        return subprocess.Popen(
            self.spec.command,
            stdin=stdin,
            stdout=output,
            stderr=log,
            start_new_session=True,  # Ctrl-C goes to the supervisor only, which ends the others in order
            preexec_fn=lambda: begin(me),
            pass_fds=self.spec.fds,
            env=os.environ | ONE_THREAD,
        )

    def read_output(self) -> bool:
        """Reads its output; True if it contains `ready`. Lines of other kinds than those of the head go to its log."""
        output = self._read()
        self.last_output_s, self.worked_s = now_s(), 0.0
        *lines, self._line = (self._line + output).split(b"\n")
        noted = [line for line in lines if line.startswith(NOTE)]
        self._news += [line.removeprefix(NOTE).decode(errors="replace") for line in noted]
        calls = [line for line in lines if line.startswith(CALLS)]
        self.called = calls[-1].removeprefix(CALLS).decode(errors="replace") if calls else self.called
        other = [line for line in lines if line.strip() not in (READY, ALIVE) and line not in (*noted, *calls)]
        if other:
            with contextlib.suppress(OSError), open_log(self.log) as log:
                log.write(b"\n".join([*other, b""]))
        return READY in lines

    def take_news(self) -> list[str]:
        """The notes since the last call."""
        news, self._news = self._news, []
        self.notes += news
        return news

    def _read(self) -> bytes:
        try:
            output = os.read(self.output_fd, 1 << 16)
        except BlockingIOError:
            return b""
        self.output_over = not output
        return output

    def look(self, now: float) -> None:
        """Updates `stopped_since_s`, `busy_s` and `worked_s`; `now` in s (rtc.runtime.process.now_s)."""
        try:
            state, total_s = usage(self.pid)
        except OSError:
            return
        # State T: stopped by a signal such as SIGSTOP.
        self.stopped_since_s = (self.stopped_since_s or now) if state == "T" else 0.0
        if (worked_s := total_s - self._total_s) > 0.0:
            self.worked_s += worked_s
            self._total_s, self.busy_s = total_s, now

    def signal(self, number: signal.Signals) -> None:
        if self.exited_fd >= 0:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(self.exited_fd, number)

    def reap(self) -> int:
        """Its exit status, negative for a signal. To be called when `exited_fd` is readable.

        What it has started ends with it: each process of a cluster is the leader of a group."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)
        if self._popen is not None:
            status = self._popen.wait()
        else:
            status = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        if self.line is not None:
            self.line.close()
        os.close(self.exited_fd)
        os.close(self.output_fd)
        self._popen, self.line, self.pid = None, None, 0
        self.exited_fd = self.output_fd = -1
        return status

    def log_tail(self, lines: int = 15) -> str:
        """The last lines of its log; empty without a log."""
        try:
            with open(self.log, "rb") as log:
                log.seek(max(0, log.seek(0, os.SEEK_END) - 8192))
                return "\n".join(log.read().decode(errors="replace").splitlines()[-lines:])
        except OSError:
            return ""


def reap_orphans(known: Container[int]) -> None:
    """Reaps ended processes that are not in `known`: adopted ones, which were forked but never registered."""
    with contextlib.suppress(ChildProcessError):
        while (dead := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)) and dead.si_pid not in known:
            os.waitpid(dead.si_pid, 0)


NICENESS = os.getpriority(os.PRIO_PROCESS, 0)  # at the start, before the supervisor lowered its own


def begin(supervisor: int) -> None:
    """Runs in the child before exec."""
    die_with_parent(supervisor)
    os.setpriority(os.PRIO_PROCESS, 0, NICENESS)


# Numeric libraries start a thread per core at import, which slows down many workers on few cores.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def limit_log(log: Path) -> None:
    """Copies a log beyond LOG_LIMIT aside and truncates it. Its writer has it open for appending and continues."""
    with contextlib.suppress(OSError):
        if log.stat().st_size > LOG_LIMIT:
            with contextlib.suppress(OSError):  # on a full disk a part of the copy is lost
                shutil.copyfile(log, log.with_suffix(".log.1"))
            os.truncate(log, 0)


def open_log(log: Path) -> BinaryIO:
    """A log, opened for appending. Without room for a new file, /dev/null: the output is lost."""
    try:
        return open(log, "ab")
    except OSError:
        return open(os.devnull, "ab")
