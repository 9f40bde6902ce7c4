"""Halts through the gateway: sent at once on a connection made in advance, and the answers returned to the callers."""

from __future__ import annotations

import contextlib
from collections import OrderedDict, deque
from collections.abc import Collection
from typing import Any, NamedTuple

import msgspec
import zmq

from broker.gateway.endpoints import MAX_MESSAGES, ServerSockets, close
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import RefusalReason, WireError
from rtc.runtime.keys import KnownKey
from rtc.runtime.process import Process, inbox, send
from rtc.runtime.settings import Settings

RETRY_S, KEPT_S = 0.02, 1.0  # retry period and time limit of a halt while its receiver restarts
HALTS_KEPT = 2_000  # maximum number of halts whose callers are stored
NO_CALLER = (b"", "")

_read_answer = wire.reader(m.FromHalt)


class Waiting(NamedTuple):
    """A halt that its receiver has not accepted yet."""

    key: KnownKey
    endpoint: str
    session: bytes
    order: m.HaltOrder
    until_s: float


class HaltForwarder:
    def __init__(self, me: Process, settings: Settings, endpoints: ServerSockets) -> None:
        self._me, self._settings, self._endpoints = me, settings, endpoints
        self._lines: dict[tuple[str, str], zmq.Socket[bytes]] = {}  # by endpoint and public key
        self._endpoint_of: dict[Any, str] = {}  # socket -> endpoint
        self._count = 0
        # (endpoint, number of a halt, or its name for answers without number) -> (session, the caller's number)
        self._callers: OrderedDict[tuple[str, str], tuple[bytes, str]] = OrderedDict()
        self._waiting: deque[Waiting] = deque(maxlen=HALTS_KEPT)

    @property
    def waiting(self) -> bool:
        """A halt waits for its receiver; call `retry` after RETRY_S."""
        return bool(self._waiting)

    def connect(self, endpoint: str, key: KnownKey) -> zmq.Socket[bytes]:
        """The halt socket of a key. It is connected in advance: a halt must never wait in a queue for a restarted
        broker."""
        line = self._lines.get((endpoint, key.public))
        if line is None:

            def at_once(socket: zmq.Socket[Any]) -> None:
                socket.setsockopt(zmq.IMMEDIATE, 1)

            line = self._me.socket(zmq.DEALER, self._settings.endpoint(endpoint), secure=at_once)
            self._lines[endpoint, key.public] = line
            self._endpoint_of[line] = endpoint
        return line

    def forward(self, endpoint: str, key: KnownKey, session: bytes, order: m.HaltOrder, now: float) -> None:
        """Send a halt into the cluster under a unique number, because two callers may use one name."""
        self._count += 1
        call = f"gate {self._count}"
        self._callers[endpoint, call] = self._callers[endpoint, order.halt] = session, order.call
        while len(self._callers) > HALTS_KEPT:
            self._callers.popitem(last=False)
        order = msgspec.structs.replace(order, called_at_s=now, call=call)
        if not send(self.connect(endpoint, key), order):
            self._waiting.append(Waiting(key, endpoint, session, order, now + KEPT_S))

    def retry(self, known: Collection[str], now: float) -> None:
        """Offer the waiting halts again. `known`: public keys that are still admitted."""
        for _ in range(len(self._waiting)):
            halt = self._waiting.popleft()
            if halt.key.public not in known or send(self.connect(halt.endpoint, halt.key), halt.order):
                continue
            if now < halt.until_s:
                self._waiting.append(halt)
            else:
                receiver = "the broker" if halt.endpoint == "halt" else "the MCM"
                self._endpoints.count("unsent", f"a halt of {halt.key.name}, to {receiver}")
                words = f"{receiver} is unavailable"
                self._endpoints.refuse(halt.endpoint, halt.session, halt.order, words, RefusalReason.TIMEOUT)

    def answer(self, readable: Collection[Any]) -> None:
        """Return the answers of broker and MCM to the callers."""
        for line in readable:
            if (endpoint := self._endpoint_of.get(line)) is None:
                continue
            for parts in inbox(line, MAX_MESSAGES):
                with contextlib.suppress(WireError):
                    answer: m.FromHalt = _read_answer(parts)
                    if isinstance(answer, m.Declined):
                        session, _ = self._callers.get((endpoint, answer.request), NO_CALLER)
                    else:
                        session, call = self._callers.get((endpoint, answer.call or answer.halt), NO_CALLER)
                        parts = wire.frames(msgspec.structs.replace(answer, call=call))
                    if session:
                        self._endpoints.send(endpoint, session, parts)

    def close(self, public: Collection[str]) -> None:
        """Close the connections of removed keys."""
        for (endpoint, key), socket in [item for item in self._lines.items() if item[0][1] in public]:
            del self._lines[endpoint, key], self._endpoint_of[socket]
            close(self._me, socket)
