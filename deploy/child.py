"""One process of the cluster, as its parent sees it: started, heard to be ready, seen to end. It decides nothing.

A process is started by running its command, or, when its spec names a template that is at work, by having that fork.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
from collections import deque
from collections.abc import Container
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import BinaryIO

from deploy.restarts import Death
from rtc.process import ALIVE, NOTE, READY, die_with_parent, now_s

LOG_LIMIT = 10 << 20  # bytes; then the log becomes NAME.log.1 and begins anew
REMEMBERED_DEATHS = 100
NOTES_KEPT = 5
FORK_LIMIT_S = 1.0  # a template answers in milliseconds


@dataclass(frozen=True)
class Spec:
    """What to run under which name. It must write the line `ready` to its stdout."""

    name: str
    command: tuple[str, ...]
    node: int | None = None  # a worker's address
    is_template: bool = False  # others are forked from it: it gets a line for orders as its stdin
    beats: bool = False  # when its loop turns it says so every second: one that does not is hung
    later: bool = False  # of a template: nothing needs it to begin with, so it is started when the cluster is ready
    template: str = ""  # the process that this one can be forked from, and
    order: bytes = b""  # what that must be told
    awaits_template: bool = False  # it starts no quicker by itself than its template does
    fds: tuple[int, ...] = ()  # files that it inherits


class State(StrEnum):
    """Where a process is; the word `rtc status` shows."""

    STARTING = "starting"
    READY = "ready"
    WAITING = "restarting"  # until its next start
    LOOPING = "crash loop"  # the same, but not at once: it has died too often too soon
    FAILED = "failed"  # given up
    ENDING = "ending"  # told to end
    ENDED = "ended"


class Line:
    """The supervisor's end of a line to a template: one order, one answer, one word to begin."""

    def __init__(self) -> None:
        self._ours, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)  # whole messages
        self._ours.settimeout(FORK_LIMIT_S)

    def fork(self, order: bytes, *fds: int) -> tuple[int, int]:
        """(pid, pidfd) of a new process, a child of ours; `fds` are its stdout, stderr and stdin, if it has one.

        It becomes nothing before our word comes through a pipe of its own. Does the answer come too late, or are we
        dead, then it finds that pipe's end there and ends: nobody would watch it. Raises OSError when there is no
        answer in time, and from then on."""
        begin, word = os.pipe()
        try:
            socket.send_fds(self._ours, [order], [begin, *fds])
            answer = self._ours.recv(32)
            if not answer:
                raise ConnectionError("the template is gone")
            pid = int(answer)
            pidfd = os.pidfd_open(pid)
            os.write(word, b"!")
            return pid, pidfd
        except OSError:
            self.close()  # an answer that comes now must not be taken for that to the next order
            raise
        finally:
            os.close(begin)
            os.close(word)

    def close(self) -> None:
        self._ours.close()


class Child:
    """`exited_fd` becomes readable when the process ends, `output_fd` when it says something."""

    def __init__(self, spec: Spec, log: Path) -> None:
        self.spec = spec
        self.log = log
        self.state = State.WAITING
        self.since_s = now_s()
        self.heard_s = 0.0  # when it said something last
        self.busy_s = 0.0  # when it was seen to use the processor last
        self.stopped_since_s = 0.0  # by a signal; 0 = it is not
        self.restarts = 0
        self.notes: deque[str] = deque(maxlen=NOTES_KEPT)  # that it told people, in all its lives
        self._news: list[str] = []  # notes that nobody has taken
        self.was_ready = False  # in any of its lives
        self.deaths: deque[Death] = deque(maxlen=REMEMBERED_DEATHS)
        self.start_at_s = 0.0  # while WAITING or LOOPING: when to start it
        self.kill_at_s = 0.0  # while ENDING: when patience ends
        self.exited_fd = self.output_fd = -1
        self.line: Line | None = None  # of a template
        self.pid = 0  # 0 = none
        self._popen: subprocess.Popen[bytes] | None = None  # None also when it was forked from a template
        self.output_over = False  # it has closed its stdout
        self._line = b""
        self._worked = 0  # processor time used, as seen last

    @property
    def waits(self) -> bool:
        """For its next start."""
        return self.state in (State.WAITING, State.LOOPING)

    def become(self, state: State) -> None:
        self.state, self.since_s = state, now_s()

    def start(self, template: Line | None = None) -> None:
        """Run it, or have the template fork it, its stderr going to the log. Raises OSError when that cannot be."""
        limit_log(self.log)
        self.output_fd, output = os.pipe()
        self.line = Line() if self.spec.is_template else None
        stdin = (self.line.theirs.fileno(),) if self.line else ()
        try:
            with open_log(self.log) as log:
                if template is None:
                    self._popen = self._run(output, log.fileno(), *stdin)
                    self.pid, self.exited_fd = self._popen.pid, os.pidfd_open(self._popen.pid)
                else:
                    self.pid, self.exited_fd = template.fork(self.spec.order, output, log.fileno(), *stdin)
        except OSError:
            if self._popen is not None:  # unwatched it must not live
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
                self.line.theirs.close()  # then its death closes the line
        os.set_blocking(self.output_fd, False)
        self._line, self.output_over = b"", False
        self.become(State.STARTING)

    def _run(self, output: int, log: int, stdin: int = subprocess.DEVNULL) -> subprocess.Popen[bytes]:
        me = os.getpid()
        return subprocess.Popen(
            self.spec.command,
            stdin=stdin,
            stdout=output,
            stderr=log,
            start_new_session=True,  # Ctrl-C is for the supervisor, who ends the others in order
            preexec_fn=lambda: _begin(me),
            pass_fds=self.spec.fds,
            env=os.environ | ONE_THREAD,
        )

    def heard_ready(self) -> bool:
        """Read what it said; True when `ready` was among it. Anything but that and `alive` goes to its log."""
        said = self._read()
        self.heard_s = now_s()
        *lines, self._line = (self._line + said).split(b"\n")
        noted = [line for line in lines if line.startswith(NOTE)]
        self._news += [line.removeprefix(NOTE).decode(errors="replace") for line in noted]
        other = [line for line in lines if line.strip() not in (READY, ALIVE) and line not in noted]
        if other:
            with contextlib.suppress(OSError), open_log(self.log) as log:
                log.write(b"\n".join([*other, b""]))
        return READY in lines

    def take_news(self) -> list[str]:
        """The notes that came since the last time."""
        news, self._news = self._news, []
        self.notes += news
        return news

    def _read(self) -> bytes:
        try:
            said = os.read(self.output_fd, 1 << 16)
        except BlockingIOError:
            return b""
        self.output_over = not said
        return said

    def look(self, now: float) -> None:
        """Whether it is stopped, and whether it has worked since the last look."""
        try:
            fields = Path(f"/proc/{self.pid}/stat").read_bytes().rpartition(b") ")[2].split()
        except OSError:
            return
        # A process that is stopped by a signal (SIGSTOP) does nothing, whatever it is.
        self.stopped_since_s = (self.stopped_since_s or now) if fields[0] == b"T" else 0.0
        worked = int(fields[11]) + int(fields[12])  # utime and stime, 10 ms each; proc(5)
        if worked != self._worked:
            self._worked, self.busy_s = worked, now

    def signal(self, number: signal.Signals) -> None:
        if self.exited_fd >= 0:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(self.exited_fd, number)

    def reap(self) -> int:
        """Its exit status, negative for a signal, once `exited_fd` says it is over."""
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
        """The last words of its log."""
        try:
            with open(self.log, "rb") as log:
                log.seek(max(0, log.seek(0, os.SEEK_END) - 8192))
                return "\n".join(log.read().decode(errors="replace").splitlines()[-lines:])
        except OSError:
            return ""


def reap_strangers(known: Container[int]) -> None:
    """Wait for what was forked away and has ended before it was anything: it is ours by adoption alone."""
    with contextlib.suppress(ChildProcessError):
        while (dead := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)) and dead.si_pid not in known:
            os.waitpid(dead.si_pid, 0)


NICENESS = os.getpriority(os.PRIO_PROCESS, 0)  # as we were started, before the supervisor took a better one


def _begin(supervisor: int) -> None:
    """In the child, before it becomes what it shall be."""
    die_with_parent(supervisor)
    os.setpriority(os.PRIO_PROCESS, 0, NICENESS)


# Numeric libraries start a thread per core when they are imported; many workers on few cores only lose by that.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def limit_log(log: Path) -> None:
    """Put a log that has grown too long aside. Its writer has it open for appending and goes on at the beginning."""
    with contextlib.suppress(OSError):
        if log.stat().st_size > LOG_LIMIT:
            with contextlib.suppress(OSError):  # on a full disk a part of it is lost: it must not grow for ever
                shutil.copyfile(log, log.with_suffix(".log.1"))
            os.truncate(log, 0)


def open_log(log: Path) -> BinaryIO:
    """A log, for appending. On a full disk there may be no room for a new one: then what is said there is lost."""
    try:
        return open(log, "ab")
    except OSError:
        return open(os.devnull, "ab")


def in_words(status: int) -> str:
    """An exit status for people: `killed by SIGKILL`, `ended with status 1`."""
    if status < 0:
        return f"killed by {signal.Signals(-status).name}"
    return f"ended with status {status}"
