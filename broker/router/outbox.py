"""What the broker sends to one peer in one turn of its loop leaves as one message.

A peer that has not announced that it reads arrays gets each message alone. Halts do not pass through here, but what
was to be sent before a halt still is (`flush`).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import zmq

from rtc.runtime.process import send, send_together

PEERS_KEPT = 10_000  # that read arrays; one that is forgotten gets its messages alone


class Outbox:
    """Of one ROUTER socket. `socket()` is that socket now: it may be opened anew."""

    def __init__(self, socket: Callable[[], zmq.Socket[bytes]]) -> None:
        self._socket = socket
        self._waiting: dict[bytes, list[Any]] = {}
        self._read_arrays: OrderedDict[bytes, None] = OrderedDict()

    def set_arrays(self, peer: bytes, reads_arrays: bool) -> None:
        """What a peer has announced in its hello."""
        self._read_arrays.pop(peer, None)
        if reads_arrays:
            self._read_arrays[peer] = None
            if len(self._read_arrays) > PEERS_KEPT:
                self._read_arrays.popitem(last=False)

    def put(self, peer: bytes, message: Any) -> None:
        """Send this to `peer` at the end of the turn. `message` may be encoded already (`msgspec.Raw`)."""
        if peer in self._waiting:
            self._waiting[peer].append(message)
        else:
            self._waiting[peer] = [message]

    def send_now(self, peer: bytes, message: Any) -> None:
        """Send this alone, after what was put before it."""
        if peer in self._waiting:
            self._send(peer, self._waiting.pop(peer))
        send(self._socket(), message, peer)

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
