"""A real cluster with an attacker at its sockets: no process dies or grows, and all others are served.

`python -m tests.campaigns.fuzz` does the same for longer, and measures how long the others wait.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq

from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import OutcomeKind
from rtc.protocol.versions import VERSION
from rtc.runtime.settings import Settings
from tests.campaigns.fuzz import Others, attacked
from tests.campaigns.hostile import ACCEPTED, IMPOSTORS, Attacker, heavy_messages, stream_garbage
from tests.campaigns.odd_values import ARMS, DOORS, Doors, odd_package

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

SEED = 7
MESSAGES = 600  # at each endpoint
GROWTH_MB = 150.0
COUNTED = [name for name in ACCEPTED if name not in ("telemetry", "events")]  # these two read nothing
LIMIT_S = 60.0
ATTACKS = 6  # at each door


@pytest.fixture(scope="module")
def mode(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The file that states what the installed odd package does."""
    with odd_package(tmp_path_factory.mktemp("odd") / "package") as mode:
        yield mode


@pytest.fixture(scope="module")
def run_dir(mode: Path) -> Iterator[Path]:
    with own_cluster(mcm="kinematic", speed="max") as run_dir:
        yield run_dir


@pytest.fixture
def others(run_dir: Path) -> Iterator[Others]:
    others = Others(run_dir)
    yield others
    others.close()


@pytest.fixture
def context() -> Iterator[zmq.Context[Any]]:
    context: zmq.Context[Any] = zmq.Context()
    yield context
    context.destroy(linger=0)


@pytest.mark.parametrize("endpoint", ACCEPTED)
def test_bad_input_at_an_endpoint_hurts_no_one(
    run_dir: Path, others: Others, context: zmq.Context[Any], endpoint: str
) -> None:
    settings, rng = Settings.load(run_dir), random.Random(SEED)
    before, pids, memory_mb = dropped(others.rtc, endpoint), others.pids(), others.memory_mb()
    attacker = Attacker(context, settings, endpoint, rng)
    for _ in range(10):
        attacker.send(MESSAGES // 10)
        stream_garbage(settings, endpoint, rng)
    attacker.send(3, heavy_messages(rng))
    attacker.close()
    attacker = Attacker(context, settings, endpoint, rng)
    attacker.send(50)

    noticed = others.notice(0.5)

    assert not noticed.wrong
    assert not [name for name, pid in others.pids().items() if pids.get(name, pid) != pid]
    assert all(others.memory_mb()[name] - memory_mb[name] < GROWTH_MB for name in memory_mb)
    if endpoint in COUNTED:
        wait_for(lambda: dropped(others.rtc, endpoint) > before)
    attacker.close()


def test_no_value_of_a_user_ends_the_arms_or_keeps_halt_waiting(run_dir: Path, mode: Path) -> None:
    doors = Doors(run_dir, mode, SEED, slow=False)
    for door in DOORS[:-1] * ATTACKS:  # without the page, which is a process of its own
        doors.attack(door)
    noticed = doors.noticed
    doors.close()
    assert noticed.wrong == []
    assert [name for name in ARMS if noticed.deaths[name]] == []
    assert doors.late_halts() == 0
    assert noticed.halts_s


@pytest.mark.parametrize("attack", ["sentences", "nonsense", "questions", "reads", "halts", "estops", "large"])
def test_a_flood_from_one_leaves_the_others_served(run_dir: Path, others: Others, attack: str) -> None:
    with attacked(run_dir, attack, SEED):
        noticed = others.notice(0.5)

    assert not noticed.wrong
    assert not noticed.died
    assert noticed.growth_mb < GROWTH_MB
    assert noticed.commands_s
    assert len(noticed.halts_s) == len(noticed.broker_halts_s) == len(noticed.commands_s)


@pytest.mark.parametrize(
    ("endpoint", "name"), [(endpoint, name) for endpoint in ("workers", "supervisor") for name in IMPOSTORS[endpoint]]
)
def test_after_an_impostor_has_gone_all_is_well(
    run_dir: Path, context: zmq.Context[Any], endpoint: str, name: bytes
) -> None:
    """Given an impostor with the name of one of our processes, when it goes, then that process comes back.

    Here only the owner of the directory can be one.
    """
    hello: dict[str, Any] = {
        "workers": m.WorkerHello(protocol=VERSION, name=name.decode(), node=0, kind=m.WorkerKind.PARSER, pid=1),
        "subsystems": m.SubsystemHello(protocol=VERSION, name=name.decode(), pid=1, performers=["LEFT-ARM"]),
        "supervisor": m.ProcessTable(processes=[]),
    }
    impostor = context.socket(zmq.DEALER)
    impostor.setsockopt(zmq.IDENTITY, name)
    impostor.connect(Settings.load(run_dir).endpoint(endpoint))
    impostor.send_multipart(wire.frames(hello[endpoint]))
    impostor.poll(200)
    impostor.close(linger=0)

    with Client(run_dir) as rtc:
        assert rtc.halt().confirmed
        wait_for(lambda: rtc.run("STOW LEFT-ARM", timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED)


def dropped(rtc: Client, endpoint: str) -> int:
    return int(rtc.status().counters.get(f"dropped_{endpoint}", 0))


def wait_for(condition: Any, tries: int = 200) -> None:
    """`condition` asks the cluster, which takes its time each time."""
    assert any(condition() for _ in range(tries))
