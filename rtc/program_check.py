"""A program put to the test in a process of its own, under limits of time and memory.

A grammar of a few hundred bytes can cost minutes or all the stack to compile: whoever checks it must be nobody that
others wait for. `check` is the check itself; `Process` is one in a child (`python -m rtc.program_check`), which the
kernel ends at its limits. What kills its child, or is not done in time, is refused in words.
"""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import subprocess
import sys

import msgspec

from rtc import wire
from rtc.messages import WorkerKind
from rtc.outcomes import ProgramError, WireError
from rtc.process import die_with_parent, now_s

CPU_S = 3  # of processor time; a default program takes a tenth of it, and a parser that takes so long is killed
WALL_S = 25.0  # on a machine with other things to do
MEMORY_BYTES = 1 << 30


class Asked(msgspec.Struct, frozen=True, kw_only=True):
    """A file to be put into a program, or to be taken back (`reset`), beside the other programs in use."""

    kind: WorkerKind
    name: str
    body: bytes
    reset: bool
    program: bytes  # of this kind, as it is
    others: dict[WorkerKind, bytes]


class Checked(msgspec.Struct, frozen=True, kw_only=True):
    """The whole program and what has changed, in words; or what is wrong."""

    merged: bytes = b""
    changes: list[str] = []
    error: str = ""


_read_asked, _read_checked = wire.decoder(Asked), wire.decoder(Checked)


def check(asked: Asked) -> Checked:
    """The check itself, here and now."""
    from rtc import program  # brings lark, yaml and numpy

    try:
        if asked.reset:
            merged = program.original(asked.kind, asked.others)
        else:
            merged = program.merge(asked.kind, asked.program, asked.name, asked.body, asked.others)
        return Checked(merged=merged, changes=program.changes(asked.kind, asked.program, merged))
    except ProgramError as error:
        return Checked(error=str(error))


class Process:
    """One check in a child."""

    def __init__(self, asked: Asked, cpu_s: int = CPU_S) -> None:
        """Raises OSError when no process can be started."""
        self._cpu_s = cpu_s
        self._name, self._limit_s = asked.name, now_s() + WALL_S
        self._answer = os.memfd_create("rtc-checked", os.MFD_CLOEXEC)
        question = os.memfd_create("rtc-asked", os.MFD_CLOEXEC)  # a pipe would make us wait for the child to read
        try:
            os.pwrite(question, wire.encode(asked), 0)
            command = (sys.executable, "-P", "-m", "rtc.program_check", str(os.getpid()), str(cpu_s))
            self._child = subprocess.Popen(command, stdin=question, stdout=self._answer, stderr=subprocess.DEVNULL)
        except OSError:
            os.close(self._answer)
            raise
        finally:
            os.close(question)

    def result(self, now: float) -> Checked | None:
        """What came of it; None as long as it is at work."""
        status = self._child.poll()
        if status is None:
            if now < self._limit_s:
                return None
            self._child.kill()
            self._child.wait()
        answer = os.pread(self._answer, os.fstat(self._answer).st_size, 0)
        os.close(self._answer)
        with contextlib.suppress(WireError):
            return _read_checked(answer)
        return Checked(error=f"{self._name}: {_why(status, self._cpu_s)}")


def _why(status: int | None, cpu_s: int) -> str:
    if status is None:
        return f"the check was not done within {WALL_S:g} s; load it again when the machine has less to do"
    if status == -signal.SIGXCPU:
        return f"it takes more than {cpu_s} s of processor time to compile; say less with ?, ~ and templates"
    return f"the check of it died (status {status}): it takes too much memory, or is nested too deeply"


def in_a_process(asked: Asked, cpu_s: int = CPU_S) -> Checked:
    """Check in a child, and wait for it."""
    running = Process(asked, cpu_s)
    while (checked := running.result(now_s())) is None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            running._child.wait(0.1)
    return checked


def main() -> None:
    die_with_parent(int(sys.argv[1]))
    cpu_s = int(sys.argv[2])
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.nice(5)
    asked = _read_asked(sys.stdin.buffer.read())
    os.write(1, wire.encode(check(asked)))


if __name__ == "__main__":
    main()
