"""The feed of an observer, with the sockets of a broker played by the test."""

from __future__ import annotations

from collections.abc import Iterator
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import msgspec
import pytest
import zmq

from rtc.apps.observers.feed import Feed
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.runtime.process import Process, send
from rtc.runtime.settings import Settings
from tests.apps.observers.conftest import until
from tests.apps.observers.samples import STOWED, note

read_query = wire.reader(m.ClientToBroker)


class Played(NamedTuple):
    feed: Feed
    events: zmq.Socket
    front: zmq.Socket
    world: zmq.Socket

    def queries(self, kind: type, wait_ms: int = 0) -> Iterator[tuple[bytes, Any]]:
        """The queries of a kind that have arrived, each with its sender. The feed requests the status repeatedly."""
        while self.front.poll(wait_ms):
            sender, *parts = self.front.recv_multipart()
            if isinstance(query := read_query(parts), kind):
                yield sender, query


@pytest.fixture
def played() -> Iterator[Played]:
    with TemporaryDirectory(prefix="rtc-") as folder:  # a short path: sockets are in it
        settings = Settings(run_dir=folder)
        me = Process("test", settings.path)
        try:
            events = me.socket(zmq.XPUB, settings.endpoint("events"), bind=True, poll=False)
            front = me.socket(zmq.ROUTER, settings.endpoint("front"), bind=True, poll=False)
            world = me.socket(zmq.ROUTER, settings.endpoint("world"), bind=True, poll=False)
            feed = Feed(me, settings, telemetry=False, world=True)
            assert events.poll(10_000)
            events.recv()  # it has subscribed
            yield Played(feed, events, front, world)
        finally:
            me.close()


def read(feed: Feed, how_many: int) -> list:
    found: list = []
    until(lambda: found.extend(feed.read(0.1)) or len(found) >= how_many)
    return [received.message for received in found]


def test_events_arrive_in_order_and_gaps_are_counted(played):
    numbers = (4, 5, 8, 0, 9)  # 6 and 7 are lost; 0 is outside the numbered stream
    for seq in numbers:
        send(played.events, note(seq, 0.0, m.Phase.EXECUTING))
    assert [message.seq for message in read(played.feed, len(numbers))] == list(numbers)
    assert played.feed.lost == 2


def test_a_stream_that_begins_again_is_not_a_gap(played):
    for seq in (7, 8, 1, 2):
        send(played.events, note(seq, 0.0, m.Phase.EXECUTING))
    read(played.feed, 4)
    assert played.feed.lost == 0


def test_the_record_of_a_new_command_is_requested_once(played):
    for event in STOWED[:3]:
        send(played.events, event)
    read(played.feed, 3)
    sender, query = next(played.queries(m.TraceQuery, wait_ms=10_000))
    assert query.command == "C-1"
    assert not list(played.queries(m.TraceQuery))
    record = m.CommandRecord(
        command="C-1", text="STOW", source="operator", request="r", accepted_at_s=1.0, phase=m.Phase.PARSING
    )
    send(played.front, m.TraceReply(request=query.request, record=record), sender)
    assert read(played.feed, 1) == [record]


def test_the_status_is_requested(played):
    list(played.feed.read(0.0))
    assert next(played.queries(m.StatusQuery, wait_ms=10_000))


def test_only_new_facts_are_requested(played):
    read_request = wire.reader(m.ToWorld)

    def request() -> m.ReadView:
        until(lambda: list(played.feed.read(0.1)) or played.world.poll(0))
        sender, *parts = played.world.recv_multipart()
        send(played.world, m.View(request="facts", version=7, facts=[]), sender)
        return read_request(parts)

    assert request().since == 0
    assert read(played.feed, 1) == [m.View(request="facts", version=7, facts=[])]
    until(lambda: request().since == 7)  # on a slow machine others were sent before the view arrived


def test_an_event_keeps_its_bytes(played):
    send(played.events, STOWED[0])
    found: list = []
    until(lambda: found.extend(played.feed.read(0.1)) or found)
    assert msgspec.msgpack.decode(found[0].event)["command"] == "C-1"
