"""Who is refused is counted with the reason, and reported: a real gateway in a thread; the test is broker and peers."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zmq

from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.roles import Role
from rtc.protocol.versions import VERSION
from rtc.runtime.keys import KeyFile, KeyRing, endpoint_address
from rtc.runtime.process import now_s
from tests.broker.gateway.test_worker_addresses import BINDER, LIMIT_MS, Cluster, Worker

HERE = "127.0.0.1"
OUT_S = 1.0  # a revoked key is out within this time
MUTE_MS = 1_200  # longer than OUT_S
HELLO = m.WorkerHello(protocol=VERSION, name="binder@18", node=18, kind=BINDER, pid=1)
RESULTS = m.ResultBatch(name="binder@18", results=[m.JobCrashed(id="C-1/1", attempt=1, evidence="late")])
read_report = wire.reader(m.GatewayReport | m.UnreadableMessages | m.ProcessHello)


class Reported(Cluster):
    """A cluster whose test also reads the reports of the gateway."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.path = path
        self._reports = self.context.socket(zmq.ROUTER)
        self._reports.setsockopt(zmq.ROUTER_HANDOVER, 1)  # as in the broker: the next gateway has the same identity
        self._reports.bind(self.settings.endpoint("supervisor"))
        self._peers: list[Any] = []  # a socket without a reference is closed
        self.counts: dict[str, int] = {}

    def row(self, wanted: Callable[[m.PeerRow], bool]) -> m.PeerRow:
        """The first reported row that is as wanted."""
        end_s = now_s() + LIMIT_MS / 1e3
        self._reports.setsockopt(zmq.RCVTIMEO, LIMIT_MS)  # what a poll has found may go with the connection
        while now_s() < end_s:
            report = read_report(self._reports.recv_multipart()[1:])
            if isinstance(report, m.UnreadableMessages):
                self.counts = report.counts
            elif isinstance(report, m.GatewayReport) and (row := next(filter(wanted, report.peers), None)) is not None:
                return row
        raise AssertionError("not reported as wanted")

    def refused(self, key: str) -> m.PeerRow:
        return self.row(lambda row: row.key == key and row.refused > 0)

    def peer(self, key: KeyFile, endpoint: str) -> Any:
        """A connecting socket. Once its key is refused, a send that waits would wait for ever."""
        socket = self.context.socket(zmq.DEALER)
        key.secure(socket)
        socket.connect(endpoint_address(key.address, endpoint))
        self._peers.append(socket)
        return socket

    def new_key(self, role: Role, name: str) -> KeyFile:
        return self.ring.new(name, role, self.settings.listen, self.path / f"{name}.key")

    def broker_gets_nothing(self) -> bool:
        return not self.broker.poll(0)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Reported]:
    made = Reported(tmp_path)
    yield made
    made.close()


def joined(cluster: Reported, pid: int = 1) -> Worker:
    """A worker with the address 18 that the broker knows."""
    worker = cluster.worker()
    worker.hello = msgspec.structs.replace(HELLO, pid=pid)
    worker.send(worker.hello)
    assert cluster.recv()[1].pid == pid
    return worker


# --- who joined ------------------------------------------------------------------------------------------


def test_a_worker_is_reported_with_its_host_and_round_trip_and_when_it_is_lost(cluster: Reported) -> None:
    assert cluster.row(lambda row: row.key == "w1").host == ""  # not used yet
    worker = joined(cluster)
    worker.send(m.Heartbeat(name="binder@18", round_trip_s=0.002))

    row = cluster.row(lambda row: bool(row.workers) and row.workers[0].round_trip_s is not None)
    assert (row.key, row.role, row.host, row.refused, row.lost) == ("w1", "worker", HERE, 0, {})
    assert [(one.name, one.round_trip_s) for one in row.workers] == [("binder@18", 0.002)]

    worker._socket.close(linger=0)
    row = cluster.row(lambda row: bool(row.lost))
    assert (row.workers, list(row.lost), row.connections) == ([], ["binder@18"], 0)


def test_a_worker_that_takes_leave_is_not_lost(cluster: Reported) -> None:
    worker = joined(cluster)
    cluster.row(lambda row: bool(row.workers))
    worker.send(m.WorkerGone(name="binder@18", in_order=True))
    assert cluster.row(lambda row: row.host == HERE and not row.workers).lost == {}


# --- who is refused --------------------------------------------------------------------------------------


def test_an_unknown_key_is_refused_and_counted_by_its_host(cluster: Reported, tmp_path: Path) -> None:
    stranger = KeyRing(tmp_path / "other").new("eve", Role.WORKER, cluster.settings.listen, tmp_path / "eve.key")
    cluster.peer(msgspec.structs.replace(stranger, cluster=cluster.key.cluster), "workers")

    row = cluster.refused("")
    assert (row.host, row.role, row.refused, row.connections) == (HERE, "", 1, 0)
    assert "not known" in row.refusal


def test_a_revoked_key_is_refused_by_name_also_by_the_next_gateway(cluster: Reported) -> None:
    cluster.ring.revoke("w1")
    for gateway in (1, 2):
        with contextlib.suppress(zmq.Again):
            cluster.peer(cluster.key, "workers").send_multipart(wire.frames(HELLO), zmq.NOBLOCK)
        row = cluster.row(lambda row: row.key == "w1" and row.refused > 0)
        assert (row.revoked, row.role, row.host) == (True, "worker", HERE)
        assert "revoked" in row.refusal
        if gateway == 1:
            cluster.stop_gateway()
            while cluster.broker.poll(0):  # its key may have been known until the next look at the keys
                cluster.broker.recv_multipart()
            cluster.start_gateway()
    assert cluster.broker_gets_nothing()


@pytest.mark.parametrize(("role", "endpoint"), [(Role.WORKER, "front"), (Role.OPERATOR, "workers")])
def test_a_key_of_another_role_is_refused_at_the_handshake(cluster: Reported, role: Role, endpoint: str) -> None:
    cluster.peer(cluster.new_key(role, "other"), endpoint)

    row = cluster.refused("other")
    assert (row.role, row.connections) == (role, 0)
    assert f"{role} may not connect to {endpoint}" in row.refusal
    assert cluster.row(lambda row: row.key == "w1").refused == 0


@pytest.mark.parametrize(
    "message",
    [
        m.CommandText(request="r", text="STOW LEFT-ARM"),
        m.HaltOrder(halt="H-1"),
        m.ClientHello(protocol=VERSION, client="x"),
    ],
    ids=lambda message: type(message).__name__,
)
def test_a_worker_that_speaks_as_a_client_is_refused(cluster: Reported, message: m.Message) -> None:
    worker = joined(cluster)
    worker.send(message)

    row = cluster.refused("w1")
    assert (row.refused, row.host) == (1, HERE)
    assert type(message).__name__ in row.refusal
    assert cluster.broker_gets_nothing()


# --- stale workers ---------------------------------------------------------------------------------------


def test_results_from_before_a_cut_are_refused_and_the_worker_must_register(cluster: Reported) -> None:
    worker = joined(cluster)
    worker.connect()
    worker.send(RESULTS)

    assert worker.recv() == m.HelloWanted()
    row = cluster.refused("w1")
    assert (row.refused, "binder@18" in row.refusal) == (1, True)
    assert cluster.broker_gets_nothing()
    cluster.row(lambda row: cluster.counts.get("gate_stale") == 1)


def test_the_second_process_with_a_chosen_address_is_refused_while_the_first_is_alive(cluster: Reported) -> None:
    first = joined(cluster, pid=1)
    second = cluster.worker()
    end_s = now_s() + LIMIT_MS / 1e3
    while not second._socket.poll(0) and now_s() < end_s:  # the first one may be silent for a moment
        first.send(m.Heartbeat(name="binder@18"))
        second.send(msgspec.structs.replace(HELLO, pid=2))
        second._socket.poll(100)

    refusal = second.recv()
    assert isinstance(refusal, m.Shutdown)
    assert "binder@18" in refusal.why
    assert "binder@18" in cluster.refused("w1").refusal
    first.send(RESULTS)
    messages = [cluster.recv()[1]]
    while not isinstance(messages[-1], m.ResultBatch):
        messages.append(cluster.recv()[1])
    assert all(isinstance(one, m.Heartbeat) for one in messages[:-1])


def test_an_address_is_free_again_when_its_worker_is_lost(cluster: Reported) -> None:
    first = joined(cluster, pid=1)
    first._socket.close(linger=0)
    assert cluster.recv()[1] == m.WorkerGone(name="binder@18")
    joined(cluster, pid=2)


# --- a key is revoked while its holder is at work ----------------------------------------------------------


@pytest.mark.parametrize("role", [Role.WORKER, Role.OPERATOR])
def test_a_holder_that_sends_without_end_is_out_within_a_second(cluster: Reported, role: Role) -> None:
    """Its messages no longer reach the cluster, and its connection is closed."""
    endpoint, socket = "workers", cluster.broker
    hello, message = HELLO, m.Heartbeat(name="binder@18")
    if role is Role.OPERATOR:
        endpoint, socket = "front", cluster.context.socket(zmq.ROUTER)
        socket.bind(cluster.settings.endpoint("front"))
        hello, message = m.ClientHello(protocol=VERSION, client="x"), m.StatusQuery(request="s")
    key = cluster.new_key(role, "leaver")
    stop = threading.Event()

    def send_without_end() -> None:
        own = cluster.peer(key, endpoint)
        own.setsockopt(zmq.SNDTIMEO, 10)
        own.send_multipart(wire.frames(hello))
        while not stop.is_set():
            try:
                own.send_multipart(wire.frames(message))
            except zmq.Again:
                continue
            stop.wait(0.001)
        own.close(linger=0)

    sender = threading.Thread(target=send_without_end)
    sender.start()
    try:
        assert socket.poll(LIMIT_MS)
        cluster.row(lambda row: row.key == "leaver" and row.connections > 0)
        cluster.ring.revoke("leaver")
        revoked_s = last_s = now_s()
        while socket.poll(MUTE_MS):
            socket.recv_multipart()
            last_s = now_s()
            assert last_s - revoked_s < LIMIT_MS / 1e3
        assert last_s - revoked_s < OUT_S
        row = cluster.row(lambda row: row.key == "leaver" and row.revoked and row.refused > 0)
        assert row.connections == 0
    finally:
        stop.set()
        sender.join()


def test_the_workers_of_a_revoked_key_are_reported_as_lost(cluster: Reported) -> None:
    """So their jobs do not wait for a time limit."""
    joined(cluster)
    cluster.ring.revoke("w1")
    assert cluster.recv()[1] == m.WorkerGone(name="binder@18")
