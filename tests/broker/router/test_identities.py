"""Names of processes belong to the processes of the cluster: a stranger that uses one gets nothing."""

from __future__ import annotations

import pytest

from broker.decisions.events import HaltCalled
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.versions import VERSION
from rtc.runtime.handover import Handover
from tests.broker.flat_events import made
from tests.broker.router.bench import SETTINGS, Bench

TOKEN = "0123456789abcdef"

OURS = f"MCM@{TOKEN}".encode()

SUPERVISOR = f"supervisor@{TOKEN}".encode()

HELLO = m.SubsystemHello(protocol=VERSION, name="MCM", pid=7, performers=["LEFT-ARM"])


@pytest.fixture
def supervised() -> Bench:
    bench = Bench(Handover(SETTINGS, b"k" * 32, TOKEN))
    row = {"name": "MCM", "pid": 7, "state": "ready", "since_s": 0.0}
    bench.send("supervisor", SUPERVISOR, {"type": "ProcessTable", "processes": [row]})
    bench.send("subsystems", OURS, HELLO)
    return bench


def test_a_stranger_that_calls_itself_mcm_is_refused_in_words(supervised: Bench) -> None:
    stranger = m.SubsystemHello(protocol=VERSION, name="MCM", pid=8, performers=["LEFT-ARM"])
    (refused,) = supervised.send("subsystems", b"MCM", stranger, m.Heartbeat(name="MCM"))
    assert "pid 7" in refused.refusal.message  # wording: who has the name
    assert supervised.state.subsystems["MCM"].pid == 7
    supervised.router.enqueue(made(HaltCalled, at_s=supervised.now, client="x", halt="H", scope="ALL"))
    assert [type(order) for order in supervised.send("subsystems", OURS, m.Heartbeat(name="MCM"))] == [m.HaltOrder]


def test_a_stranger_that_calls_itself_supervisor_changes_nothing(supervised: Bench) -> None:
    supervised.send("supervisor", b"supervisor", m.ProcessTable(processes=[]))
    assert [row.name for row in supervised.router.core.processes] == ["MCM"]


def test_a_subsystem_that_is_lost_although_it_runs_is_started_anew(supervised: Bench) -> None:
    socket = supervised.sockets["supervisor"]
    for _ in range(90):  # 9 s, in which it sends nothing
        supervised.now += 0.099
        supervised.turn()
    asked = [wire.reader(m.BrokerToSupervisor)(parts[1:]) for parts in socket.sent if parts[0] == SUPERVISOR]
    (kill,) = [order for order in asked if isinstance(order, m.KillProcess)]
    assert (kill.name, kill.pid) == ("MCM", 7)
    assert "lost to the broker" in kill.why


def test_the_status_tells_how_old_the_list_of_processes_is(supervised: Bench) -> None:
    supervised.now += 12.0
    (reply,) = supervised.send("front", b"ann", m.StatusQuery(request="q"))
    assert reply.status.supervisor_silent_s == pytest.approx(12.0, abs=0.1)
