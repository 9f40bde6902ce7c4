"""Outbox: all messages for one peer in one iteration of the broker's loop are sent as one.

A peer that has not announced that it reads arrays gets each message alone. A halt is sent at once, after the messages
that were put before it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import zmq

from rtc.runtime.process import send, send_together

PEERS_KEPT = 10_000  # maximum number of peers known to read arrays; others get their messages alone


class Outbox:
    """Outbox of one ROUTER socket. `socket()` is the current socket: it may be opened anew."""

    def __init__(self, socket: Callable[[], zmq.Socket[bytes]]) -> None:
        self._socket = socket
        self._waiting: dict[bytes, list[Any]] = {}
        self._read_arrays: OrderedDict[bytes, None] = OrderedDict()

    def set_arrays(self, peer: bytes, reads_arrays: bool) -> None:
        """Record what a peer has announced in its hello."""
        self._read_arrays.pop(peer, None)
        if reads_arrays:
            self._read_arrays[peer] = None
            if len(self._read_arrays) > PEERS_KEPT:
                self._read_arrays.popitem(last=False)

    def put(self, peer: bytes, message: Any) -> None:
        """Send this to `peer` at the end of the iteration. `message` may be encoded already (`msgspec.Raw`)."""
        if peer in self._waiting:
            self._waiting[peer].append(message)
        else:
            self._waiting[peer] = [message]

    def send_now(self, peer: bytes, message: Any) -> bool:
        """Send this alone, after what was put before it. False: the peer is gone, or its queue is full."""
        if peer in self._waiting:
            self._send(peer, self._waiting.pop(peer))
        return send(self._socket(), message, peer)

    def flush(self) -> None:
        waiting, self._waiting = self._waiting, {}
        for peer, messages in waiting.items():
            self._send(peer, messages)

    def _send(self, peer: bytes, messages: list[Any]) -> None:
        if peer in self._read_arrays:
            send_together(self._socket(), messages, peer)
        else:
            for message in messages:
                send(self._socket(), message, peer)
