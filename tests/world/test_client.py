"""A real server loop behind a real socket: asked by the client, fed with rubbish, killed and started again."""

from __future__ import annotations

import threading

import pytest
import zmq

from rtc.protocol import wire
from rtc.protocol.messages import Committed, Heartbeat, WorldChange
from rtc.protocol.outcomes import ClusterError, Refusal
from rtc.runtime.process import Process
from rtc.world.__main__ import serve
from rtc.world.client import WorldClient
from rtc.world.lease import sign
from rtc.world.server import Server
from rtc.world.store import Store

KEY = b"k" * 32


class Running:
    """The server's loop in a thread, as the process has it."""

    def __init__(self, path):
        self.endpoint = f"ipc://{path}/world.sock"
        self.path = path

    def start(self):
        self.process = Process("world", self.path)
        socket = self.process.socket(zmq.ROUTER, self.endpoint, bind=True)
        self.thread = threading.Thread(target=self._run, args=(socket,))
        self.thread.start()

    def _run(self, socket):
        store = Store(self.path / "world.db")
        if store.version == 0:
            store.write("cell", [WorldChange(key="A.seat", value="BAY-1")], "cell", 0.0)
        serve(self.process, socket, Server(store, KEY))
        store.close()

    def stop(self):
        self.process.stop()
        self.thread.join(5)
        assert not self.thread.is_alive()
        self.process.close()


@pytest.fixture
def world(tmp_path):
    running = Running(tmp_path)
    running.start()
    yield running
    running.stop()


@pytest.fixture
def client(world):
    made = WorldClient(world.endpoint, limit_s=5.0)
    yield made
    made.close()


def test_reading_and_committing(client):
    assert [f.value for f in client.view().facts] == ["BAY-1"]
    lease = sign(KEY, "C-1/4", ["A"])
    change = [WorldChange(key="A.seat", value="RACK-1")]
    assert client.commit(lease, change, "C-1/4").version == 2
    assert client.commit(lease, change, "C-1/4").version == 2
    assert [f.value for f in client.view(since=1).facts] == ["RACK-1"]
    assert [f.value for f in client.history("A.seat")] == ["RACK-1", "BAY-1"]
    assert isinstance(client.commit(lease, [WorldChange(key="B.seat", value="")], "x"), Refusal)


def test_rubbish_neither_ends_the_server_nor_hinders_others(world, client):
    vandal = zmq.Context.instance().socket(zmq.DEALER)
    vandal.connect(world.endpoint)
    for parts in (
        [b""],
        [b"x"] * 50,
        [wire.PROTOCOL, b"\xff\x00"],
        [b"RTC9", wire.encode({"type": "ReadView"})],
        wire.frames(Heartbeat(name="not for the world")),
        [wire.PROTOCOL, wire.encode({"type": "ReadView", "request": 7})],
        [wire.PROTOCOL, b"\x91" * 100_000],
    ):
        vandal.send_multipart(parts)
    assert [f.value for f in client.view().facts] == ["BAY-1"]
    vandal.close(0)


def test_a_client_finds_the_restarted_server_and_what_it_had_written(world, client):
    client.commit(sign(KEY, "C-1/4", ["A"]), [WorldChange(key="A.seat", value="RACK-1")], "C-1/4")
    world.stop()
    # When: a request is sent into the void, and the server comes back while it waits
    threading.Timer(0.05, world.start).start()
    again = client.commit(sign(KEY, "C-1/4", ["A"]), [WorldChange(key="A.seat", value="elsewhere")], "C-1/4")
    assert again == Committed(request=again.request, version=2)
    assert client.view().facts[0].value == "RACK-1"


def test_a_missing_server_is_an_error_within_the_limit(tmp_path):
    alone = WorldClient(f"ipc://{tmp_path}/unbound.sock", limit_s=0.05)
    with pytest.raises(ClusterError, match=r"did not answer within 0\.05 s"):
        alone.view()
    alone.close()
