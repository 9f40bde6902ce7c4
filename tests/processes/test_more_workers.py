"""A real cluster whose machine has reached its limit runs the user's script, whose workers join and do the rest."""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol.messages import HostRow, MoreWorkersRow
from rtc.protocol.outcomes import OutcomeKind
from rtc.protocol.roles import Role
from rtc.runtime.keys import KeyRing
from rtc.runtime.process import now_s
from rtc.runtime.process_table import processes
from tests.processes.test_gateway import LIMIT_S, free_ports, wait_for

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

OWN = "elaborator@1"
ATTEMPTS = 5  # a slow broker may overlook a job that waits for one second only
SCRIPT = """
for n in $(seq "$2"); do
    {python} -P -m workers --kind "$1" --with {key} &
    echo $! >> {pids}
done
"""


@pytest.fixture
def run_dir(tmp_path: Path) -> Iterator[Path]:
    """A cluster with one worker of each kind and a script that starts others in the background."""
    script, key, pids = tmp_path / "more.sh", tmp_path / "w1.key", tmp_path / "pids"
    script.write_text(SCRIPT.format(python=sys.executable, key=shlex.quote(str(key)), pids=shlex.quote(str(pids))))
    more = f"sh {shlex.quote(str(script))} {{kind}} {{count}}"
    address = f"tcp://127.0.0.1:{free_ports()}"
    with own_cluster(mcm="kinematic", speed="max", most=1, listen=address, more=more) as path:
        KeyRing(path).new("w1", Role.WORKER, address, key)
        try:
            yield path
        finally:
            for pid in pids.read_text().split() if pids.exists() else ():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(int(pid), signal.SIGKILL)


def test_a_script_starts_the_workers_that_the_machine_may_not_have(run_dir: Path) -> None:
    """The own elaborator is stopped by a signal, so that a job waits for it however fast the machine is."""
    with Client(run_dir) as here, Client(run_dir) as other:
        attempts = 0
        while not (asked := here.status().asked_for):
            assert (attempts := attempts + 1) <= ATTEMPTS
            _stop_a_new_elaborator(here, run_dir)
            _stow_both(here, other)
        assert (asked[0].kind, asked[0].asked) == ("elaborator", 1)

        wait_for(lambda: _request(here).joined == 1)
        wait_for(lambda: _host(here).round_trip_ms is not None)

        host = _host(here)
        assert (host.host, host.joined, host.refused) == ("127.0.0.1", 1, 0)
        assert (_request(here).running, _request(here).failed) == (False, "")
        end_s = now_s() + LIMIT_S
        while not _stow_both(here, other) & set(host.workers):  # it takes part
            assert now_s() < end_s
        assert _request(here).ago_s >= asked[0].ago_s  # it was asked for once


def _stop_a_new_elaborator(rtc: Client, run_dir: Path) -> None:
    """A new worker has no job in hand and takes one at a time. The supervisor kills a stopped one after 2 s."""
    old = processes(run_dir)[OWN].pid
    os.kill(old, signal.SIGKILL)
    wait_for(lambda: any(row.name == OWN and row.pid != old for row in rtc.status().workers))
    os.kill(processes(run_dir)[OWN].pid, signal.SIGSTOP)


def _stow_both(first: Client, second: Client) -> set[str]:
    """Two commands at a time; the processes that took part."""
    commands = [first.submit("STOW LEFT-ARM"), second.submit("STOW RIGHT-ARM")]
    ended = [command.wait(LIMIT_S) for command in commands]
    assert {one.outcome.kind for one in ended} == {OutcomeKind.SUCCEEDED}
    return {note.node for command in commands for note in first.trace(command.number).notes}


def _request(rtc: Client) -> MoreWorkersRow:
    (one,) = rtc.status().asked_for
    return one  # type: ignore[no-any-return]


def _host(rtc: Client) -> HostRow:
    return next(row for row in rtc.status().hosts if row.key == "w1")
