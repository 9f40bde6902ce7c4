"""The simulated sockets do what ZeroMQ's do: each test runs on both."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from random import Random

import pytest
import zmq

from rtc.protocol.wire import PROTOCOL
from rtc.runtime.process import inbox, open_socket, send
from tests.simulation.network import Clock, Dealer, Router

Received = list[tuple[bytes, ...]]


class Simulated:
    def __init__(self) -> None:
        self.clock = Clock(Random(1))
        self.router = self.bind()

    def bind(self) -> Router:
        self.router = Router(self.clock, lambda: None, lambda: None)
        return self.router

    def connect(self, name: str, received: Received) -> Dealer:
        dealer = Dealer(self.clock, name.encode(), lambda parts: received.append(tuple(parts)))
        dealer.connect(self.router)
        return dealer

    def send(self, dealer: Dealer, word: str) -> None:
        dealer.send([PROTOCOL, word.encode()])

    def restart(self, dealers: list[Dealer], between: Callable[[], None]) -> None:
        self.router.close()
        between()
        self.bind()
        for dealer in dealers:
            dealer.connect(self.router)

    def until(self, done: Callable[[], bool]) -> None:
        while not done():
            self.clock.step()

    def close(self) -> None: ...


class Real:
    def __init__(self, folder: str) -> None:
        self.context = zmq.Context()
        self.address = f"ipc://{folder}/s"
        self.router = self.bind()
        self.received: list[tuple[zmq.Socket[bytes], Received]] = []

    def bind(self) -> zmq.Socket[bytes]:
        self.router = open_socket(self.context, zmq.ROUTER, self.address, bind=True)
        return self.router

    def connect(self, name: str, received: Received) -> zmq.Socket[bytes]:
        dealer = open_socket(self.context, zmq.DEALER, self.address, identity=name)
        self.received.append((dealer, received))
        return dealer

    def send(self, dealer: zmq.Socket[bytes], word: str) -> None:
        dealer.send_multipart([PROTOCOL, word.encode()])

    def restart(self, dealers: list[zmq.Socket[bytes]], between: Callable[[], None]) -> None:
        monitors = [dealer.get_monitor_socket(zmq.EVENT_DISCONNECTED) for dealer in dealers]
        self.router.close(linger=0)
        for dealer, monitor in zip(dealers, monitors, strict=True):
            assert monitor.poll(2000), "the end of the connection is noticed"
            dealer.disable_monitor()
            monitor.close(linger=0)
        between()
        self.bind()

    def until(self, done: Callable[[], bool]) -> None:
        end_s = time.monotonic() + 5
        while not done():
            assert time.monotonic() < end_s
            for dealer, received in self.received:
                received += [tuple(parts) for parts in inbox(dealer)]
            self.router.poll(1)

    def close(self) -> None:
        self.context.destroy(linger=0)


@pytest.fixture(params=["simulated", "real"])
def net(request, tmp_path) -> Iterator[Simulated | Real]:
    made = Simulated() if request.param == "simulated" else Real(str(tmp_path))
    yield made
    made.close()


def receives(net, words: list[tuple[bytes, bytes]]) -> Callable[[], bool]:
    """True once the ROUTER has read just these (who, word), in this order."""
    read: list[tuple[bytes, bytes]] = []

    def done() -> bool:
        read.extend((who, word) for who, _, word in inbox(net.router))
        assert read == words[: len(read)]
        return len(read) == len(words)

    return done


def test_messages_keep_their_order_and_name_their_sender(net):
    a = net.connect("a", [])
    for n in range(20):
        net.send(a, str(n))
    net.until(receives(net, [(b"a", str(n).encode()) for n in range(20)]))


def test_a_message_without_a_receiver_is_dropped(net):
    received: Received = []
    a = net.connect("a", received)
    net.send(a, "hello")
    net.until(receives(net, [(b"a", b"hello")]))
    assert send(net.router, {"to": "b"}, b"b")
    assert send(net.router, {"to": "a"}, b"a")
    net.until(lambda: len(received) == 1)
    assert b"a" in received[0][1]


def test_a_dealer_keeps_messages_without_a_router_and_a_new_router_does_not_know_it_before(net):
    received: Received = []
    a = net.connect("a", received)
    net.send(a, "one")
    net.until(receives(net, [(b"a", b"one")]))
    net.restart([a], lambda: net.send(a, "two"))
    net.until(receives(net, [(b"a", b"two")]))
    assert send(net.router, {}, b"a")
    net.until(lambda: len(received) == 1)


def test_an_empty_queue_raises_as_zeromq_does(net):
    with pytest.raises(zmq.Again):
        net.router.recv(zmq.NOBLOCK, copy=False)
