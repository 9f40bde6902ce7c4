"""Addresses that the gateway assigns to remote workers: a real gateway in a thread; the test is broker and workers."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq

from broker.gateway.gateway import Gateway
from broker.gateway.sessions import PEERS_OF_KEY
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.roles import Role
from rtc.protocol.versions import VERSION
from rtc.runtime.keys import KeyFile, KeyRing
from rtc.runtime.memory_guard import MemoryGuard
from rtc.runtime.process import Process
from rtc.runtime.settings import Settings
from tests.processes.test_gateway import free_ports

LIMIT_MS = 10_000
BINDER, ANALYZER = m.WorkerKind.BINDER, m.WorkerKind.ANALYZER
read_worker, read_broker = wire.reader(m.WorkerToBroker), wire.reader(m.BrokerToWorker)


class Worker:
    """The connection of a worker; each message is awaited within LIMIT_MS."""

    def __init__(self, context: zmq.Context[Any], key: KeyFile, instance: str = "", kind: m.WorkerKind = BINDER):
        self._context, self._key = context, key
        self._sockets: list[Any] = []  # earlier ones stay connected
        self.hello = m.WorkerHello(protocol=VERSION, name=kind.value, node=None, kind=kind, pid=1, instance=instance)
        self.connect()

    def connect(self) -> None:
        self._socket = self._context.socket(zmq.DEALER)
        self._key.secure(self._socket)
        self._socket.connect(self._key.endpoint("workers"))
        self._sockets.append(self._socket)

    def send(self, message: Any) -> None:
        self._socket.send_multipart(wire.frames(message))

    def recv(self) -> Any:
        """The next message except the gateway's probes."""
        while self._socket.poll(LIMIT_MS):
            message = read_broker(self._socket.recv_multipart())
            if message != m.CancelJobs(jobs=[]):
                return message
        raise AssertionError("no answer")

    def join(self, node: int | None = None) -> Any:
        if node is not None:
            self.hello = m.WorkerHello(
                protocol=VERSION,
                name=f"{self.hello.kind}@{node}",
                node=node,
                kind=self.hello.kind,
                pid=1,
                instance=self.hello.instance,
            )
        self.send(self.hello)
        return self.recv()


NO_LIMIT = MemoryGuard(math.inf)  # what other tests have left in this process is no sign of a flood


class Cluster:
    """A gateway, and the socket of its broker."""

    def __init__(self, path: Path) -> None:
        self.settings = Settings(run_dir=str(path), listen=f"tcp://127.0.0.1:{free_ports()}")
        self.ring = KeyRing(path)
        self.key = self.ring.new("w1", Role.WORKER, self.settings.listen, path / "w1.key")
        self.context: zmq.Context[Any] = zmq.Context()
        self._workers: list[Worker] = []  # a connection without a reference is closed
        self.broker = self.context.socket(zmq.ROUTER)
        self.broker.setsockopt(zmq.ROUTER_HANDOVER, 1)  # as in the broker: a name may return on a new connection
        self.broker.bind(self.settings.endpoint("workers"))
        self.start_gateway()

    def start_gateway(self) -> None:
        self._process = Process("gate", Path(self.settings.run_dir))
        self._gateway = Gateway(self._process, self.settings, self.ring)
        self._thread = threading.Thread(target=self._gateway.run, args=(NO_LIMIT,))
        self._thread.start()

    def stop_gateway(self) -> None:
        self._process.stop()
        self._thread.join()
        self._process.close()

    def worker(self, instance: str = "", kind: m.WorkerKind = BINDER) -> Worker:
        self._workers.append(Worker(self.context, self.key, instance, kind))
        return self._workers[-1]

    def recv(self) -> tuple[str, Any]:
        """(identity, message) of the next message at the broker."""
        assert self.broker.poll(LIMIT_MS)
        peer, *parts = self.broker.recv_multipart()
        return peer.decode(), read_worker(parts)

    def close(self) -> None:
        self.stop_gateway()
        self.context.destroy(linger=0)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    made = Cluster(tmp_path)
    yield made
    made.close()


def test_workers_without_an_address_get_the_lowest_free_ones_of_their_kind(cluster: Cluster) -> None:
    addresses = [cluster.worker(name).join() for name in ("a", "b")]
    addresses.append(cluster.worker("c", ANALYZER).join())

    assert addresses == [
        m.WorkerAddress(name="binder@18", node=18),
        m.WorkerAddress(name="binder@22", node=22),
        m.WorkerAddress(name="analyzer@19", node=19),
    ]
    hellos = [cluster.recv() for _ in range(3)]
    assert [(peer, hello.name, hello.node) for peer, hello in hellos] == [
        (address.name, address.name, address.node) for address in addresses
    ]


def test_a_worker_keeps_its_address_on_a_new_connection(cluster: Cluster) -> None:
    first, second = cluster.worker("a"), cluster.worker("b")
    assert (first.join().node, second.join().node) == (18, 22)

    first.connect()  # the gateway has not noticed the end of the old connection

    assert first.join().node == 18


def test_a_worker_keeps_its_address_when_the_gateway_restarts(cluster: Cluster) -> None:
    workers = [cluster.worker(name) for name in ("a", "b")]
    nodes = [worker.join().node for worker in workers]
    cluster.stop_gateway()
    cluster.start_gateway()
    for worker, node in [*zip(workers, nodes, strict=True)][::-1]:
        worker.connect()
        assert worker.join(node).node == node


def test_an_address_that_was_lost_meanwhile_is_replaced_and_never_shared(cluster: Cluster) -> None:
    first, second = cluster.worker("a"), cluster.worker("b")
    assert first.join().node == 18
    assert second.join(18).node == 22


def test_an_explicit_address_takes_it_from_an_assigned_worker_that_then_gets_another(cluster: Cluster) -> None:
    assigned = cluster.worker("a")
    assert assigned.join().node == 18
    chosen = cluster.worker()
    chosen.hello = m.WorkerHello(protocol=VERSION, name="binder@18", node=18, kind=BINDER, pid=2)
    chosen.send(chosen.hello)
    assert [cluster.recv()[1].pid for _ in range(2)] == [1, 2]

    assigned.send(m.Heartbeat(name="binder@18"))
    assert assigned.recv() == m.HelloWanted()
    assert assigned.join(18).node == 22


def test_a_worker_that_takes_leave_frees_its_address_and_the_broker_knows_why(cluster: Cluster) -> None:
    worker = cluster.worker("a")
    worker.join()
    worker.send(m.WorkerGone(name="binder@22", in_order=True))  # its name follows from its connection

    assert cluster.recv()[1].name == "binder@18"
    assert cluster.recv() == ("binder@18", m.WorkerGone(name="binder@18", in_order=True))
    assert cluster.worker("b").join().node == 18


def test_a_rejected_worker_receives_the_reason(cluster: Cluster) -> None:
    rejected = cluster.worker().join(2)
    assert isinstance(rejected, m.Shutdown)
    assert "node 2" in rejected.why
    without = cluster.worker().join()
    assert isinstance(without, m.Shutdown)
    assert "address" in without.why


def test_a_key_has_a_limited_number_of_workers_and_the_next_one_displaces_none(cluster: Cluster) -> None:
    workers = [cluster.worker(f"w{n}") for n in range(PEERS_OF_KEY)]
    assert len({worker.join().node for worker in workers}) == PEERS_OF_KEY

    rejected = cluster.worker("further").join()

    assert isinstance(rejected, m.Shutdown)
    assert "rtc keys new" in rejected.why
    assert workers[0].join().node == 18
