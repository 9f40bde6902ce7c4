"""Which processes the supervisor judges as hung: by processor time, because on a busy machine everything is late."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from deploy import child as children
from deploy.child import Child, ForkConnection, ProcessState, Spec
from deploy.supervisor import (
    END_LIMIT_S,
    MAX_END_S,
    MAX_SILENT_S,
    SILENT_S,
    _ended_too_late,
    _hung,
)

T0 = 1000.0


def child(state: ProcessState, worked_s: float, busy_s: float) -> Child:
    """A process without output since T0, which has used the processor for so long, the last time at `busy_s`."""
    made = Child(Spec("world", (), beats=True), Path("/nowhere"))
    made.state = state
    made.since_s = made.last_output_s = T0
    made.worked_s, made.busy_s = worked_s, busy_s
    return made


@pytest.mark.parametrize(
    ("silent_s", "worked_s", "idle_s", "hung"),
    [
        (SILENT_S + 10.0, 0.3, 0.5, False),  # a busy machine
        (SILENT_S + 0.1, SILENT_S, 0.0, True),  # an endless loop
        (SILENT_S + 0.1, 0.0, SILENT_S + 0.1, True),  # a deadlock
        (SILENT_S - 0.1, 0.0, SILENT_S - 0.1, False),
        (MAX_SILENT_S + 0.1, 0.3, 0.5, True),
    ],
)
def test_a_silent_process_hangs_by_processor_time_or_without_any(
    silent_s: float, worked_s: float, idle_s: float, hung: bool
) -> None:
    now = T0 + silent_s
    assert bool(_hung(child(ProcessState.READY, worked_s, now - idle_s), now)) is hung


@pytest.mark.parametrize(
    ("passed_s", "worked_s", "idle_s", "late"),
    [
        (END_LIMIT_S + 10.0, 0.3, 0.5, False),
        (END_LIMIT_S + 0.1, END_LIMIT_S + 0.1, 0.0, True),
        (END_LIMIT_S, 0.0, END_LIMIT_S, True),
        (MAX_END_S + 0.1, 0.3, 0.5, True),
    ],
)
def test_a_process_that_is_to_end_is_killed_by_the_same_rule(
    passed_s: float, worked_s: float, idle_s: float, late: bool
) -> None:
    now = T0 + passed_s
    assert _ended_too_late(child(ProcessState.ENDING, worked_s, now - idle_s), now) is late


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (ProcessState.FAILED, ProcessState.STARTING),
        (ProcessState.ENDED, ProcessState.ENDING),
        (ProcessState.ENDING, ProcessState.READY),  # its last output, after SIGTERM
        (ProcessState.PENDING, ProcessState.READY),
        (ProcessState.READY, ProcessState.STARTING),  # before its death is known
    ],
)
def test_a_process_changes_its_state_by_the_table_alone(before: ProcessState, after: ProcessState) -> None:
    made = child(before, 0.0, 0.0)
    with pytest.raises(ValueError, match=str(before)):
        made.become(after)
    assert made.state is before


def answered(command: list[str], after_s: float, monkeypatch: pytest.MonkeyPatch) -> int:
    """The pid that a fork server answers so late."""
    monkeypatch.setattr(children, "FORK_LIMIT_S", 0.5)  # long enough to get the processor once on a busy machine
    with subprocess.Popen(command) as server:
        line = ForkConnection()
        line.pid = server.pid
        answer = threading.Timer(after_s, line.theirs.send, [str(os.getpid()).encode()])
        answer.start()
        try:
            pid, pidfd = line.fork(b"start")
            os.close(pidfd)
            return pid
        finally:
            server.kill()
            answer.cancel()
            answer.join()
            line.close()
            line.theirs.close()


def test_a_fork_server_on_a_busy_machine_gets_more_time(monkeypatch: pytest.MonkeyPatch) -> None:
    assert answered([sys.executable, "-c", "while True: pass"], 0.75, monkeypatch) == os.getpid()


def test_a_fork_server_that_does_nothing_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(TimeoutError):
        answered(["sleep", "100"], 100.0, monkeypatch)
