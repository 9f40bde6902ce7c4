"""The event stream: notes, ends, refusals and halts, published to all subscribers in order.

A message that is sent alone wakes a thread here and two in each subscriber. Therefore messages that follow each other
closely wait for PERIOD_S and leave together. For a command with ten notes, `rtc record` and `rtc observe` then change
threads two times each, before seven to nine times.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import zmq

from rtc.runtime.process import Every, send

PERIOD_S = 0.02  # longest time that a message waits; after a longer silence it is sent at once


class EventStream:
    """Messages for one PUB or XPUB socket. `socket()` is the current socket: it may be opened anew."""

    def __init__(self, socket: Callable[[], zmq.Socket[bytes]]) -> None:
        self._socket = socket
        self._waiting: list[Any] = []
        self._period = Every(PERIOD_S)

    def put(self, message: Any) -> None:
        """Publish this at the next `flush_if_due`. `message` may be encoded already (`msgspec.Raw`)."""
        self._waiting.append(message)

    def send_now(self, message: Any) -> None:
        """Publish this at once, after what was put before it."""
        self._waiting.append(message)
        self.flush()

    def flush_if_due(self, now_s: float) -> None:
        if self._waiting and self._period.due(now_s):
            self.flush()

    def left_s(self, now_s: float) -> float | None:
        """The time until `flush_if_due` sends something (s); None if nothing waits."""
        return self._period.left_s(now_s) if self._waiting else None

    def flush(self) -> None:
        waiting, self._waiting = self._waiting, []
        for message in waiting:
            send(self._socket(), message)
