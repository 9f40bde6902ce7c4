"""A client behind a link of 3 s each way, and the operator's hand over tcp.

Sentences, tests and halt_if_lost work, and a lost link is reported. About 20 s, which are nearly all waiting.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol.outcomes import OutcomeKind
from rtc.protocol.roles import Role
from rtc.runtime.keys import KeyRing
from tests.processes.slow_link import SlowLink, slow_link
from tests.processes.test_gateway import free_ports

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

DELAY_S = 3.0
LIMIT_S = 60.0


@pytest.fixture(scope="module")
def run_dir() -> Iterator[Path]:
    with own_cluster(mcm="kinematic", listen=f"tcp://127.0.0.1:{free_ports()}") as path:
        yield path


def key_for(run_dir: Path, name: str, port: int) -> Path:
    file = run_dir / f"{name}.key"
    KeyRing(run_dir).new(name, Role.OPERATOR, f"tcp://127.0.0.1:{port}", file)
    return file


def port_of(run_dir: Path) -> int:
    with Client(run_dir) as rtc:
        return int(rtc.settings.listen.rpartition(":")[2])


@pytest.fixture
def link(run_dir: Path) -> Iterator[tuple[int, SlowLink]]:
    port = free_ports()
    with slow_link(port, port_of(run_dir), DELAY_S) as made:
        yield port, made


def test_the_hand_of_an_operator_with_a_key_moves_the_arm_over_tcp(run_dir: Path) -> None:
    key = key_for(run_dir, "ada", port_of(run_dir))
    with Client(key=key) as rtc:
        given = rtc.submit("GIVE RIGHT-ARM TO OPERATOR")
        with rtc.hand("RIGHT-ARM", "ADA") as hand:
            held_until_s = time.monotonic() + LIMIT_S
            while not hand.request and time.monotonic() < held_until_s:
                pass
            before = hand.state.tcp_pose
            while hand.state.tcp_pose[2] < before[2] + 0.005:
                refused = hand.move([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
                assert time.monotonic() < held_until_s, refused
                threading.Event().wait(0.02)
            assert hand.operation.operator == "ada/ADA"
            hand.release()
        # It is refused while the arm moves: until the release, and what was sent before it, have arrived.
        while (taken := rtc.run("TAKE RIGHT-ARM FROM OPERATOR", timeout_s=LIMIT_S).outcome).kind is OutcomeKind.REFUSED:
            assert time.monotonic() < held_until_s, taken
        assert taken.kind is OutcomeKind.SUCCEEDED
        assert given.wait(LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED


def test_three_seconds_each_way_and_then_the_link_is_cut(run_dir: Path, link: tuple[int, SlowLink]) -> None:
    port, relay = link
    key, reports = key_for(run_dir, "far", port), []
    with ThreadPoolExecutor() as threads, Client(run_dir) as near:
        watched = threads.submit(Client, key=key, halt_if_lost=True, on_silence=reports.append)
        plain = threads.submit(Client, key=key)
        with watched.result(LIMIT_S) as rtc, plain.result(LIMIT_S) as other:
            assert rtc.round_trip_s == pytest.approx(2 * DELAY_S, abs=1.0)
            tested = threads.submit(other.run, "TEST STOW RIGHT-ARM", timeout_s=LIMIT_S)
            given = rtc.submit("GIVE LEFT-ARM TO OPERATOR")
            assert tested.result(LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
            assert near.trace(str(given)).outcome is None  # heartbeats arrive, although they are late
            assert reports == []
            relay.cut()
            cut_at_s = time.monotonic()
            while near.trace(str(given)).outcome is None:
                assert time.monotonic() < cut_at_s + LIMIT_S
                threading.Event().wait(0.05)
            assert near.trace(str(given)).outcome.kind is OutcomeKind.HALTED
            rtc.receive_until(lambda: reports, LIMIT_S, "nothing is reported")
            assert len(reports) == 1
            assert "lost" in reports[0]
            assert "halts your commands" in reports[0]
