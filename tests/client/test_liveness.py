"""A broker that is restarted is waited for, in words; a cluster that is gone with its supervisor ends the wait."""

from __future__ import annotations

import fcntl
import threading
from pathlib import Path

import pytest

from rtc.client import core
from rtc.client.client import Client
from rtc.client.liveness import BrokerLiveness
from rtc.protocol.outcomes import NoCluster, OutcomeKind
from rtc.runtime.run_dir import supervised
from rtc.runtime.settings import LOCK, Settings
from tests.client.test_client import SmallBroker, accepting, obliging


@pytest.fixture
def run_dir(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(core, "SILENCE_S", 0.05)  # of a client that asks more often
    Settings(run_dir=str(tmp_path)).save()
    return tmp_path


def test_silence_and_its_end_are_reported_once(tmp_path: Path) -> None:
    reports: list[str] = []
    liveness = BrokerLiveness(report=reports.append)

    for unanswered in (0, 1, 2, 3, 1, 2, 0, 0, 1, 0):
        liveness.check(unanswered)

    assert [words.split(";")[0] for words in reports] == ["the broker does not answer", "the broker answers again"]


def test_a_supervisor_is_known_by_its_lock(tmp_path: Path) -> None:
    assert supervised(tmp_path)  # it cannot be known
    with open(tmp_path / LOCK, "a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert supervised(tmp_path)
    assert not supervised(tmp_path)
    assert not supervised(tmp_path / "nowhere")


def test_a_broker_that_is_restarted_is_waited_for(run_dir: Path) -> None:
    first = SmallBroker(run_dir, accepting)
    again: list[SmallBroker] = []
    silent = threading.Event()

    def report(words: str) -> None:
        if not silent.is_set():
            silent.set()
            again.append(SmallBroker(run_dir, obliging))

    with open(run_dir / LOCK, "a") as lock, Client(run_dir, on_silence=report) as rtc:
        fcntl.flock(lock, fcntl.LOCK_EX)
        command = rtc.submit("STOW LEFT-ARM 7")
        first.stop()
        ended = command.wait(10)

    assert silent.is_set()
    assert ended.outcome.kind is OutcomeKind.SUCCEEDED
    again[0].stop()


def test_a_broker_that_is_being_restarted_is_waited_for_from_the_start(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Given a supervisor and no broker, then the client comes to the one that is started meanwhile."""
    monkeypatch.setattr(core, "HELLO_S", 0.05)
    started: list[SmallBroker] = []

    with open(run_dir / LOCK, "a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with Client(run_dir, on_silence=lambda _: started.append(SmallBroker(run_dir, obliging))) as rtc:
            assert len(started) == 1
            assert rtc.status().cluster == "test"
    started[0].stop()


def test_a_broker_is_not_waited_for_when_its_supervisor_dies(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(core, "HELLO_S", 0.05)

    with open(run_dir / LOCK, "a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(NoCluster, match="no broker answers"):
            Client(run_dir, on_silence=lambda _: lock.close())


def test_a_cluster_that_is_gone_is_not_waited_for(run_dir: Path) -> None:
    broker = SmallBroker(run_dir, accepting)

    with open(run_dir / LOCK, "a") as lock, Client(run_dir) as rtc:
        fcntl.flock(lock, fcntl.LOCK_EX)
        command = rtc.submit("STOW LEFT-ARM 7")
        broker.stop()
        lock.close()  # as the kernel does it when the supervisor dies
        with pytest.raises(NoCluster, match="its supervisor has ended"):
            command.wait(10)
