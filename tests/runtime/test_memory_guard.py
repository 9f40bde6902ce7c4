"""Too much memory: which sockets are reopened, and that their peers reconnect."""

from __future__ import annotations

import pytest
import zmq

from rtc.protocol import wire
from rtc.protocol.messages import Heartbeat
from rtc.runtime.memory_guard import SETTLE_S, MemoryGuard, resident_mb
from rtc.runtime.process import Process, inbox, send


def test_a_process_of_usual_size_is_left_alone() -> None:
    guard = MemoryGuard(limit_mb=resident_mb() * 10)
    assert [guard.alarm(now_s) for now_s in (0.0, 1.0, 2.0)] == [0, 0, 0]


def test_sockets_are_reopened_in_two_stages_and_then_the_limit_is_raised() -> None:
    guard = MemoryGuard(limit_mb=1.0)
    assert guard.alarm(10.0) == 1
    assert guard.alarm(10.0 + SETTLE_S / 2) == 0  # it may still help
    assert guard.alarm(10.0 + SETTLE_S) == 2
    assert guard.alarm(10.0 + 3 * SETTLE_S) == 0
    assert guard.limit_mb > resident_mb()
    assert guard.alarm(20.0) == 0


def test_a_reopened_endpoint_is_empty_and_its_peers_come_back(tmp_path) -> None:
    me = Process("test", tmp_path)
    endpoint = f"ipc://{tmp_path}/x.sock"
    old = me.socket(zmq.ROUTER, endpoint, bind=True)
    peer = me.socket(zmq.DEALER, endpoint, identity="ann", poll=False)
    for _ in range(5):
        send(peer, Heartbeat(name="before"))
    assert me.wait(5) == [old]

    opened = me.reopen(old, endpoint)
    received = []
    while not received:
        send(peer, Heartbeat(name="after"))
        me.wait(0.05)
        received = [(who, wire.reader(Heartbeat)(parts).name) for who, *parts in inbox(opened)]

    assert set(received) == {(b"ann", "after")}
    with pytest.raises(zmq.ZMQError):
        old.getsockopt(zmq.TYPE)
    me.close()
