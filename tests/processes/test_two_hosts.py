"""Workers on another host, behind a slow link: they do the work, the link is cut, the host dies, and nothing is lost.

Two network namespaces on this machine. The cluster starts without workers of its own. It starts one of a kind only when
a job waits and no worker of that kind is there. Needs root; about half a minute in all.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from benchmarks.load.errands import Errands
from benchmarks.load.two_hosts import TwoHosts, Unavailable, inside, two_hosts
from benchmarks.load.verdict import JournalReader, Verdict, judge
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol.outcomes import OutcomeKind

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

DELAY_S, JITTER_S = 0.05, 0.02
NODES = (4, 5, 6, 7)  # the first that the cluster's own workers never use: one of each kind
LIMIT_S = 60.0
CUT_S = 10.0
AT_ONCE_S = 2.5  # shorter than any limit of silence
PAUSE = threading.Event()
STOW = ("STOW RIGHT-ARM", "STOW LEFT-ARM")
AWAY = "MOVE RIGHT-ARM TO JOINTS -40 110 -160 0 50 0 DEG JOINT-MOTION"


@pytest.fixture(scope="module")
def hosts() -> Iterator[TwoHosts]:
    try:
        with two_hosts(DELAY_S, JITTER_S) as made:
            yield made
    except Unavailable as why:
        pytest.skip(f"no second host on this machine: {why}")


@pytest.fixture(scope="module")
def run_dir(hosts: TwoHosts) -> Iterator[Path]:
    with contextlib.ExitStack() as stack:
        with inside(hosts.near):
            path = stack.enter_context(own_cluster(mcm="kinematic", listen=hosts.address, least=0, most=1))
        yield path


@pytest.fixture
def rtc(run_dir: Path) -> Iterator[Client]:
    with Client(run_dir) as client:
        yield client


@pytest.fixture
def far(hosts: TwoHosts, run_dir: Path, rtc: Client) -> set[str]:
    """Workers of each kind on the other host, all registered."""
    running = {int(name.partition("@")[2]) for name in hosts.workers}
    hosts.start_workers(run_dir, [node for node in NODES if node not in running])
    names = set(hosts.workers)
    wait_for(lambda: names <= workers(rtc))
    return names


def workers(rtc: Client) -> set[str]:
    return {row.name for row in rtc.status().workers}


def busy(rtc: Client) -> set[str]:
    return {row.name for row in rtc.status().workers if row.busy_with}


def nodes(rtc: Client, command: str) -> set[str]:
    """The workers that have done jobs of this command."""
    return {note.node for note in rtc.trace(command).notes if "@" in note.node}


def wait_for(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end_s
        PAUSE.wait(0.02)  # a client may not ask without end


def judged(errands: Errands, journal: JournalReader, run_dir: Path) -> Verdict:
    journal.close()
    return judge(errands.done, journal, run_dir, [])


def run_until_served_by(far: set[str], rtc: Client) -> None:
    """Sentences, two at a time, until one of these workers has done a job; all succeed."""
    seen: set[str] = set()
    end_s = time.monotonic() + LIMIT_S
    while not far & seen:
        assert time.monotonic() < end_s, seen
        for ended in rtc.run_many(STOW, timeout_s=LIMIT_S):
            assert ended.outcome.kind is OutcomeKind.SUCCEEDED
            seen |= nodes(rtc, ended.command)


def test_workers_behind_a_slow_link_do_all_jobs(far: set[str], rtc: Client) -> None:
    for ended in rtc.run_many([*STOW, AWAY, STOW[0]], timeout_s=LIMIT_S):
        assert ended.outcome.kind is OutcomeKind.SUCCEEDED
        assert nodes(rtc, ended.command) == far


def test_a_cut_link_delays_jobs_and_loses_nothing(hosts: TwoHosts, far: set[str], rtc: Client, run_dir: Path) -> None:
    journal = JournalReader(run_dir)
    journal.follow()
    with Errands(run_dir, nonsense=False) as errands:
        wait_for(lambda: bool(busy(rtc) & far))
        cut_s = time.monotonic()
        hosts.cut()
        wait_for(lambda: not workers(rtc) & far)
        noticed_s = time.monotonic() - cut_s
        done = len(errands.done)
        wait_for(lambda: len(errands.done) > done + 4)  # by workers on this host
    command = rtc.submit(AWAY)
    moving(rtc)
    halted = rtc.halt(timeout_s=LIMIT_S)
    assert (halted.confirmed, halted.moving) == (True, ["RIGHT-ARM"])
    assert command.wait(LIMIT_S).outcome.kind is OutcomeKind.HALTED
    assert noticed_s < CUT_S  # the campaign compares it with the declared limit; here other tests use the processor
    verdict = judged(errands, journal, run_dir)
    assert (verdict.lost, verdict.repeated, verdict.wrong, verdict.not_seen) == ([], [], [], [])

    assert not workers(rtc) & far
    hosts.restore()
    wait_for(lambda: far <= workers(rtc))
    run_until_served_by(far, rtc)
    pids = {row.name: row.pid for row in rtc.status().workers}
    assert {name: pids[name] for name in far} == hosts.workers  # the same processes


def test_the_death_of_the_other_host_is_noticed_at_once(
    hosts: TwoHosts, far: set[str], rtc: Client, run_dir: Path
) -> None:
    journal = JournalReader(run_dir)
    journal.follow()
    with Errands(run_dir, nonsense=False) as errands:
        wait_for(lambda: bool(busy(rtc) & far))
        for name in far:
            hosts.kill(name)
        killed_s = time.monotonic()
        wait_for(lambda: not workers(rtc) & far)
        assert time.monotonic() - killed_s < AT_ONCE_S
        done = len(errands.done)
        wait_for(lambda: len(errands.done) > done + 4)
    verdict = judged(errands, journal, run_dir)
    assert (verdict.lost, verdict.repeated, verdict.wrong, verdict.not_seen) == ([], [], [], [])


def moving(rtc: Client) -> None:
    """Wait until an arm moves."""
    for sample in rtc.telemetry(silence_s=LIMIT_S):
        if max(max(map(abs, arm.velocities)) for arm in sample.arms.values()) > 0.05:
            return
    raise AssertionError("no telemetry")
