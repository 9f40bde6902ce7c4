"""What an observer receives from one cluster: events, telemetry, new facts, and answers about commands and status.

It never waits for a process of the cluster: questions are sent without repetition, and an answer may be missing.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import zmq

from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import WireError
from rtc.protocol.versions import VERSION
from rtc.runtime.allowance import Allowance
from rtc.runtime.keys import Endpoints
from rtc.runtime.process import Every, Process, inbox, now_s, send
from rtc.runtime.run_dir import supervised
from rtc.runtime.settings import Settings

UNREAD = 100_000  # messages that ZeroMQ keeps for a slow observer; further events are dropped and counted
RECORDS_PER_S = 20  # maximum number of records requested per second; the broker allows a client 100 queries
STATUS_S = 2.0  # period of status requests
WORLD_S = 1.0  # period of requests for new facts
SUPERVISOR_S = 1.0  # period of checks that the cluster still runs

Observed = m.Event | m.Telemetry | m.CommandRecord | m.StatusReply | m.View
_read_event = wire.reader(m.Event)
_read_telemetry = wire.reader(m.Telemetry)
_read_answer = wire.reader(m.BrokerToClient)
_read_world = wire.reader(m.FromWorld)


class Received(NamedTuple):
    """A message, the time of its receipt (CLOCK_MONOTONIC, s), and its MessagePack bytes if it is an event."""

    at_s: float
    message: Observed
    event: bytes = b""


class Feed:
    """Subscriptions to one cluster. `lost` counts the events that did not arrive.

    `records`: request the record of each command when its first event arrives, at most RECORDS_PER_S per second.
    `world`: request the facts that are new, every WORLD_S.
    """

    def __init__(
        self,
        me: Process,
        endpoints: Endpoints,
        *,
        telemetry: bool = True,
        records: bool = True,
        world: bool = False,
    ) -> None:
        self._me = me
        self._run_dir = endpoints.path if isinstance(endpoints, Settings) else None
        self._events = self._subscribe(endpoints, "events")
        self._telemetry = self._subscribe(endpoints, "telemetry") if telemetry else None
        name = "" if endpoints.far else f"observer-{os.getpid()}~{uuid.uuid4().hex[:8]}"
        self._front = me.socket(zmq.DEALER, endpoints.endpoint("front"), identity=name, secure=endpoints.secure)
        send(self._front, m.ClientHello(client=f"observer-{os.getpid()}", at_s=now_s(), protocol=VERSION))
        self._world: zmq.Socket[bytes] | None = None
        if world:
            self._world = me.socket(zmq.DEALER, endpoints.endpoint("world"), secure=endpoints.secure)
        self._world_version, self._facts = 0, Every(WORLD_S)
        self._records = records
        self._known: set[str] = set()  # commands in progress that an event has named
        self._record_requests = Allowance(RECORDS_PER_S)
        self._status, self._look = Every(STATUS_S), Every(SUPERVISOR_S, now_s() + 1.0)
        self._seq = 0
        self.lost = 0

    def _subscribe(self, endpoints: Endpoints, name: str) -> zmq.Socket[bytes]:
        socket = self._me.socket(zmq.SUB, endpoints.endpoint(name), queue_length=UNREAD, secure=endpoints.secure)
        socket.subscribe(b"")
        for address in list(endpoints.addresses(name).values())[1:]:
            socket.connect(address)
        return socket

    def read(self, timeout_s: float) -> Iterator[Received]:
        """The messages that arrive within `timeout_s`; returns after the first ones, or at a signal."""
        self._request_status()
        self._request_facts()
        for socket in self._me.wait(timeout_s):
            for parts in inbox(socket):
                try:
                    yield from self._receive(socket, parts)
                except WireError:
                    continue  # of a newer version

    def over(self) -> bool:
        """True once the cluster on this machine has ended. Checked every SUPERVISOR_S; False for one far away."""
        return self._run_dir is not None and self._look.due(now_s()) and not supervised(self._run_dir)

    def _receive(self, socket: zmq.Socket[bytes], parts: Sequence[bytes]) -> Iterator[Received]:
        at_s = now_s()
        if socket is self._events:
            event = _read_event(parts)
            if isinstance(event, m.ProgressNote | m.CommandEnded):
                self._count(event.seq)
                self._note_command(event)
            yield Received(at_s, event, parts[-1])
        elif socket is self._telemetry:
            yield Received(at_s, _read_telemetry(parts))
        elif socket is self._world:
            if isinstance(view := _read_world(parts), m.View):
                self._world_version = view.version
                yield Received(at_s, view)
        else:
            answer = _read_answer(parts)
            if isinstance(answer, m.TraceReply):
                yield Received(at_s, answer.record)
            elif isinstance(answer, m.StatusReply):
                yield Received(at_s, answer)

    def _count(self, seq: int) -> None:
        if seq and self._seq:  # 0: outside the numbered stream; a smaller number: a broker without the old journal
            self.lost += max(0, seq - self._seq - 1)
        self._seq = seq or self._seq

    def _note_command(self, event: m.ProgressNote | m.CommandEnded) -> None:
        if isinstance(event, m.CommandEnded):
            self._known.discard(event.command)
        elif event.command and event.command not in self._known and event.phase is not m.Phase.ENDED:
            self._known.add(event.command)
            self._request_record(event.command)

    def _request_record(self, command: str) -> None:
        if self._records and self._record_requests.take(now_s()):
            send(self._front, m.TraceQuery(request=f"trace {command}", command=command))

    def _request_status(self) -> None:
        if self._status.due(now_s()):
            send(self._front, m.StatusQuery(request="status"))

    def _request_facts(self) -> None:
        if self._world is not None and self._facts.due(now_s()):
            send(self._world, m.ReadView(request="facts", since=self._world_version))
