"""A command of `rtc` in a process that the cluster forks: it begins in milliseconds, with all libraries loaded.

The libraries of most commands take 0.2 s to import. A running cluster has imported them in its process `cli-template`
(rtc.apps.cli.template). This module hands it the words, the environment and the standard streams of this process, waits
for the exit status, and forwards signals. Without a cluster, or if that process does not answer or has other code, the
caller runs the command itself. The command reads its own words: which cluster's template forks it makes no difference.

Protocol, on a Unix SEQPACKET socket: a `Call`; back the pid of the new process, which waits; `BEGIN` with the
descriptors 0, 1, 2 and that of the working directory, upon which the command begins; back its exit status, as one byte.
Each side gives up when the other has closed its end: before `BEGIN` nothing was done, after it the command is killed.
"""

from __future__ import annotations

import os
import signal
import socket
import sys

import rtc
from rtc.runtime import environment

SOCKET = "cli.sock"  # in the run directory
ANSWER_S = 0.5  # for the template to fork; then this process runs the command, so that nothing but time depends on it
BEGIN = b"!"
#: neither those that start or end a cluster or try out this environment, nor those that take over the terminal
COMMANDS = {
    *("break", "dictionary", "do", "grammar", "inject", "load", "log", "names", "observe", "operator", "outcomes"),
    *("parse", "programs", "status", "step", "teach", "test", "trace", "trust", "why", "world"),
}
FORWARDED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
OF_ONE_PROCESS = ("/dev/", "/proc/")  # a name below them may mean another file in another process: /dev/fd/63, /dev/tty
CREDENTIALS = 12  # bytes of a `struct ucred`: pid, uid, gid

TYPE_CHECKING = False  # see rtc/__init__.py
if TYPE_CHECKING:
    from types import FrameType


class Call:
    """What a process takes over from the one that was called: bytes without zeros, joined by zeros."""

    def __init__(self, words: list[str]) -> None:
        """Of this process."""
        self.code = code()
        self.words = words
        self.umask = os.umask(0o077)
        os.umask(self.umask)
        self.niceness = os.getpriority(os.PRIO_PROCESS, 0)
        self.ignored = [number for number in FORWARDED if signal.getsignal(number) == signal.SIG_IGN]
        self.streams = [(stream.encoding, stream.errors or "strict") for stream in (sys.stdin, sys.stdout, sys.stderr)]
        self.environment = environment.all_variables()

    def to_bytes(self) -> bytes:
        figures = [self.umask, self.niceness, len(self.words), len(self.ignored), *self.ignored]
        texts = [*self.code, *map(str, figures), *(text for two in self.streams for text in two)]
        variables = (name + b"=" + value for name, value in self.environment.items())
        return b"\0".join([*map(os.fsencode, [*texts, *self.words]), *variables])

    @classmethod
    def from_bytes(cls, data: bytes) -> Call:
        """Raises ValueError if these are not the bytes of a call."""
        made, parts = cls.__new__(cls), data.split(b"\0")
        left = iter(parts)

        def texts(count: int) -> list[str]:
            return [os.fsdecode(next(left)) for _ in range(count)]

        try:
            made.code = texts(len(code()))
            made.umask, made.niceness, words, ignored = map(int, texts(4))
            made.ignored = [signal.Signals(int(text)) for text in texts(ignored)]
            made.streams = [(encoding, errors) for encoding, errors in [texts(2) for _ in range(3)]]
            made.words = texts(words)
        except StopIteration:
            raise ValueError("the call is cut off") from None
        made.environment = dict(variable.split(b"=", 1) for variable in left)
        return made


def code() -> list[str]:
    """Whose commands these are: the Python, its packages and the checkout. A template of others is of no use."""
    return [sys.version, sys.prefix, str(rtc.__file__), environment.module_path()]


def run(words: list[str]) -> int | None:
    """Run the command in a forked process; its exit status. None: nothing was done, and the caller must run it."""
    if not words or words[0] not in COMMANDS or not _in_foreground():
        return None
    if any(place in word for word in words for place in OF_ONE_PROCESS):
        return None
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as line:
        line.settimeout(ANSWER_S)
        try:
            line.connect(os.path.join(_run_dir(words), SOCKET))
            if not _is_of_this_user(line):
                return None
            line.send(Call(words).to_bytes())
            if not (answer := line.recv(32)):
                return None
            directory = os.open(".", os.O_PATH)
        except OSError:
            return None
        forwarded = _forward_signals(int(answer))
        line.settimeout(None)
        try:
            socket.send_fds(line, [BEGIN], [0, 1, 2, directory])
            status = line.recv(1)
        except OSError:
            status = b""
    if status:
        return status[0]
    if forwarded:  # it has ended by that signal; so does this process
        signal.signal(forwarded[-1], signal.SIG_DFL)
        os.kill(os.getpid(), forwarded[-1])
    os.write(2, b"rtc: the process of this command was killed; see what it has begun with: rtc status\n")
    return 1


def _run_dir(words: list[str]) -> str:
    """That of the option, or of the environment; any cluster of this user will do."""
    for word, following in zip(words, [*words[1:], ""], strict=True):
        if word == "--run-dir" or word.startswith("--run-dir="):
            return word.partition("=")[2] or following
    return environment.run_dir()


def _is_of_this_user(line: socket.socket) -> bool:
    """Another user's process would have other rights, and must not see this environment: root may call any cluster."""
    credentials = line.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, CREDENTIALS)
    mine = [os.geteuid(), os.getegid()]
    return [int.from_bytes(credentials[start : start + 4], sys.byteorder) for start in (4, 8)] == mine


def _in_foreground() -> bool:
    """Whether a terminal is stdin only if its shell lets this process read from it; all three streams are open.

    The new process has no controlling terminal, so that nothing would stop it where a process in the background must
    be stopped."""
    if None in (sys.stdin, sys.stdout, sys.stderr):
        return False
    try:
        return not os.isatty(0) or os.tcgetpgrp(0) == os.getpgrp()
    except OSError:  # not the controlling terminal
        return True


def _forward_signals(process: int) -> list[int]:
    """From now on signals to this process go to that one; the numbers of those that end a process, as they come."""
    seen: list[int] = []

    def send(number: int) -> None:
        try:
            os.kill(process, number)
        except ProcessLookupError:  # it has just ended; contextlib would take a millisecond to import
            return

    def forward(number: int, _: FrameType | None) -> None:
        seen.append(number)
        send(number)

    def stop(number: int, _: FrameType | None) -> None:
        """The kernel does not stop this process if no shell could continue it: `ssh -t HOST rtc do ...`."""
        send(signal.SIGSTOP)
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        signal.signal(number, stop)
        send(signal.SIGCONT)

    for number, handler in [*((number, forward) for number in FORWARDED), (signal.SIGTSTP, stop)]:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)
    return seen
