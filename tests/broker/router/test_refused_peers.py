"""A peer that speaks another version of the protocol is refused with both versions, and still may stop what moves."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from broker.router import refused_peers
from broker.router.refused_peers import RefusedPeers
from rtc.protocol import messages as m
from rtc.protocol.outcomes import RefusalReason
from rtc.protocol.versions import VERSION
from tests.broker.router.bench import MCM, PARSER, Bench

NEWER, OLDEST = VERSION + 1, m.ClientHello(client="ann").protocol


def of_version(hello: m.Hello, version: int) -> Any:
    return msgspec.structs.replace(hello, protocol=version)


ANN = m.ClientHello(client="ann", protocol=VERSION)
PEERS = [
    ("front", b"ann", ANN),
    ("workers", b"parser@0", PARSER),
    ("subsystems", b"MCM", MCM),
    ("supervisor", b"supervisor", m.ProcessHello(name="supervisor", protocol=VERSION)),
    ("supervisor", b"world", m.ProcessHello(name="world", protocol=VERSION)),
    ("supervisor", b"gate", m.ProcessHello(name="gate", protocol=VERSION)),
]


@pytest.fixture
def bench() -> Bench:
    return Bench()


def refused(bench: Bench) -> list[dict[str, Any]]:
    (reply,) = bench.send("front", b"observer", m.StatusQuery(request="q"))
    assert reply.status.protocol == VERSION
    return [{key: getattr(row, key) for key in ("name", "socket", "protocol")} for row in reply.status.refused]


@pytest.mark.parametrize(("socket", "peer", "hello"), PEERS)
@pytest.mark.parametrize("version", [NEWER, OLDEST])
def test_a_hello_of_another_version_is_refused_with_both_versions(
    bench: Bench, socket: str, peer: bytes, hello: m.Hello, version: int
) -> None:
    (declined,) = bench.send(socket, peer, of_version(hello, version))
    assert (declined.request, declined.refusal.reason) == ("", RefusalReason.VERSION)
    assert {str(version), str(VERSION)} <= set(declined.refusal.message.split())  # wording: both versions
    assert refused(bench) == [{"name": peer.decode(), "socket": socket, "protocol": version}]
    assert (bench.router.core.registry.workers, bench.state.subsystems) == ({}, {})
    assert bench.router.core.supervised is False


@pytest.mark.parametrize(("socket", "peer", "hello"), PEERS)
def test_a_hello_that_fits_ends_the_refusal(bench: Bench, socket: str, peer: bytes, hello: m.Hello) -> None:
    bench.send(socket, peer, of_version(hello, NEWER))
    answers = bench.send(socket, peer, hello)
    assert [one for one in answers if isinstance(one, m.Declined)] == []
    assert refused(bench) == []


def test_release_0_1_states_no_version(bench: Bench) -> None:
    hello = {"type": "WorkerHello", "name": "parser@0", "node": 0, "kind": "parser", "pid": 7}
    (declined,) = bench.send("workers", b"parser@0", hello)
    assert declined.refusal.reason is RefusalReason.VERSION


def test_a_refused_worker_is_neither_asked_for_its_hello_nor_killed(bench: Bench) -> None:
    row = {"name": "parser@0", "pid": 7, "state": "ready", "since_s": 0.0}
    bench.send("supervisor", b"supervisor", {"type": "ProcessTable", "processes": [row]})
    bench.send("workers", b"parser@0", of_version(PARSER, NEWER))
    for _ in range(300):  # 30 s
        bench.now += 0.099
        assert bench.send("workers", b"parser@0", m.Heartbeat(name="parser@0")) == []
        sent = bench.sockets["supervisor"].sent
        assert not any(b"KillProcess" in parts[-1] for parts in sent)


def test_requests_of_a_refused_client_are_declined(bench: Bench) -> None:
    bench.send("front", b"ann", of_version(ANN, NEWER))
    (declined,) = bench.send("front", b"ann", m.CommandText(request="r", text="STOW LEFT-ARM"))
    assert (declined.request, declined.refusal.reason) == ("r", RefusalReason.VERSION)
    assert bench.state.accepted == 0


def test_a_halt_is_obeyed_whatever_the_version(bench: Bench) -> None:
    bench.send("subsystems", b"MCM", MCM)
    bench.send("subsystems", b"OTHER", m.SubsystemHello(name="OTHER", pid=2, performers=[]))
    bench.send("subsystems", b"OTHER", m.HaltOrder(halt="H-1"))
    assert bench.state.counts["halts"] == 1


def test_the_number_of_refused_peers_is_bounded() -> None:
    peers = RefusedPeers()
    for n in range(2 * refused_peers.MAX_REFUSED):
        peers.refusal_of("front", str(n).encode(), m.ClientHello(client=f"{n}~x"), 1.0)
    assert not peers.is_refused("front", b"0")
    assert len(peers.rows(3.0)) == refused_peers.SHOWN
    assert (peers.rows(3.0)[0].name, peers.rows(3.0)[0].ago_s) == (str(2 * refused_peers.MAX_REFUSED - 1), 2.0)
