"""A client that reads arrays gets all messages of a batch in one."""

from __future__ import annotations

from typing import Any

import msgpack

from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.versions import ARRAYS, VERSION
from tests.broker.router.bench import Bench, Socket


def bodies(socket: Socket, peer: bytes) -> list[Any]:
    return [msgpack.unpackb(parts[2]) for parts in socket.sent if parts[0] == peer]


def kinds(body: Any) -> Any:
    return [one["type"] for one in body] if isinstance(body, list) else body["type"]


def test_a_client_that_reads_arrays_gets_all_of_a_turn_in_one(bench: Bench) -> None:
    bench.send("front", b"ann", m.ClientHello(protocol=VERSION, client="ann", abilities=[ARRAYS]))
    front = bench.sockets["front"]
    for n in range(3):
        front.put([b"ann", *wire.frames(m.CommandText(request=str(n), text="X", progress=False))])
        front.put([b"bob", *wire.frames(m.CommandText(request=str(n), text="X", progress=False))])
    front.sent.clear()
    bench.turn()
    assert [kinds(body) for body in bodies(front, b"ann")] == [["Accepted"] * 3]
    assert [kinds(body) for body in bodies(front, b"bob")] == ["Accepted"] * 3


def test_a_hello_without_arrays_takes_the_word_back(bench: Bench) -> None:
    bench.send("front", b"ann", m.ClientHello(protocol=VERSION, client="ann", abilities=[ARRAYS]))
    bench.send("front", b"ann", m.ClientHello(protocol=VERSION, client="ann"))
    front = bench.sockets["front"]
    for n in range(2):
        front.put([b"ann", *wire.frames(m.CommandText(request=str(n), text="X", progress=False))])
    front.sent.clear()
    bench.turn()
    assert [kinds(body) for body in bodies(front, b"ann")] == ["Accepted"] * 2


def test_of_an_array_only_the_bad_map_is_declined(bench: Bench) -> None:
    front = bench.sockets["front"]
    good = [m.CommandText(request=str(n), text="X", progress=False) for n in (1, 3)]
    front.put([b"ann", wire.PROTOCOL, wire.encode([good[0], {"type": "CommandText", "request": "2"}, good[1]])])
    bench.turn()
    answers = {body["request"]: body["type"] for body in bodies(front, b"ann")}
    assert answers == {"1": "Accepted", "2": "Declined", "3": "Accepted"}
    assert bench.router.core.dropped["front"] == 1


def test_an_array_beyond_its_bound_is_declined_as_a_whole(bench: Bench) -> None:
    front = bench.sockets["front"]
    many = [m.CommandText(request=str(n), text="X") for n in range(wire.MAX_BATCH + 1)]
    front.put([b"ann", wire.PROTOCOL, wire.encode(many)])
    bench.turn()
    assert [kinds(body) for body in bodies(front, b"ann")] == ["Declined"]
    assert not bench.state.commands


def test_a_halt_leaves_alone_and_at_once_behind_what_was_sent_before_it(bench: Bench) -> None:
    outbox, sent = bench.router.egress.subsystems, bench.sockets["subsystems"].sent
    outbox.set_arrays(b"MCM", reads_arrays=True)
    sent.clear()
    outbox.put(b"MCM", m.ReportAck(primitive="C-1.1"))
    outbox.put(b"MCM", m.ReportAck(primitive="C-2.1"))
    outbox.send_now(b"MCM", m.HaltOrder(halt="H-1"))
    assert [kinds(body) for body in bodies(bench.sockets["subsystems"], b"MCM")] == [["ReportAck"] * 2, "HaltOrder"]
