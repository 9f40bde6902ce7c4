"""A sandbox for program checks: a child process with limits on time and memory.

A grammar of a few hundred bytes can take minutes or overflow the stack when it is compiled, so the broker must not
compile it. `check` is the check itself. `CheckProcess` runs it in a child (`python -m rtc.programs.sandbox`), which the
kernel kills at its limits. A program that kills the child or exceeds the time is refused with the reason.
"""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import subprocess
import sys

import msgspec

from rtc.protocol import wire
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import ProgramError, WireError
from rtc.runtime.process import die_with_parent, now_s

CPU_S = 3  # limit of processor time; a default program takes 0.3 s
WALL_S = 25.0  # limit of wall-clock time, generous for a loaded machine
MEMORY_BYTES = 1 << 30


class CheckRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A request: merge a file into a program, or go back to a whole program (`reset`): `body`, or the default one."""

    kind: WorkerKind
    name: str
    body: bytes
    reset: bool
    program: bytes  # of this kind, in use now
    others: dict[WorkerKind, bytes]  # the programs of the other kinds in use


class CheckResult(msgspec.Struct, frozen=True, kw_only=True):
    """The result: the merged program and its changes as text, or the error."""

    merged: bytes = b""
    changes: list[str] = []
    error: str = ""


_read_asked, _read_checked = wire.decoder(CheckRequest), wire.decoder(CheckResult)


def check(asked: CheckRequest) -> CheckResult:
    """Checks in this process."""
    from rtc.programs import loader

    try:
        if asked.reset:
            merged = loader.whole(asked.kind, asked.others, asked.body)
        else:
            merged = loader.merge(asked.kind, asked.program, asked.name, asked.body, asked.others)
        return CheckResult(merged=merged, changes=loader.changes(asked.kind, asked.program, merged))
    except ProgramError as error:
        return CheckResult(error=str(error))


class CheckProcess:
    """One check in a child process."""

    def __init__(self, asked: CheckRequest, cpu_s: int = CPU_S) -> None:
        """Raises OSError when no process can be started."""
        self._cpu_s = cpu_s
        self._name, self._limit_s = asked.name, now_s() + WALL_S
        self._answer = os.memfd_create("rtc-checked", os.MFD_CLOEXEC)
        question = os.memfd_create("rtc-asked", os.MFD_CLOEXEC)  # a write to a pipe could block until the child reads
        try:
            os.pwrite(question, wire.encode(asked), 0)
            command = (sys.executable, "-P", "-m", "rtc.programs.sandbox", str(os.getpid()), str(cpu_s))
            self._child = subprocess.Popen(command, stdin=question, stdout=self._answer, stderr=subprocess.DEVNULL)
        except OSError:
            os.close(self._answer)
            raise
        finally:
            os.close(question)

    def result(self, now: float) -> CheckResult | None:
        """The result; None while the child runs. Never blocks longer than it takes to kill the child."""
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
        return CheckResult(error=f"{self._name}: {_why(status, self._cpu_s)}")


def _why(status: int | None, cpu_s: int) -> str:
    if status is None:
        return f"the check did not finish within {WALL_S:g} s; load it again when the machine is less busy"
    if status == -signal.SIGXCPU:
        return f"it takes more than {cpu_s} s of processor time to compile; use ?, ~ and templates less"
    return f"its check died (status {status}): it takes too much memory or is nested too deeply"


def in_a_process(asked: CheckRequest, cpu_s: int = CPU_S) -> CheckResult:
    """Checks in a child process and waits for the result. Raises OSError when the child cannot start."""
    running = CheckProcess(asked, cpu_s)
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
