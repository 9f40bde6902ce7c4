"""A load client that keeps many sentences in progress at once, by the real protocol and without progress notes.

Unlike `rtc.client.client` it neither reconnects nor calls listeners, so that on few cores it takes little time from the
processes under load.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import count
from typing import Any

import zmq

from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import OutcomeKind
from rtc.protocol.versions import ARRAYS, VERSION
from rtc.runtime.process import inbox, open_socket
from rtc.runtime.settings import Settings

STUCK_S = 5.0  # without a message for this long, with sentences in progress, the cluster is stuck


class Stuck(Exception):
    """No message for STUCK_S although sentences are in progress."""


class LoadClient:
    """`text(n)` is the n-th sentence; `window` of them are in progress at any time."""

    def __init__(self, settings: Settings, text: Callable[[int], str], window: int = 1000) -> None:
        self._text, self._window = text, window
        self._context: zmq.Context[Any] = zmq.Context()
        self._socket = open_socket(
            self._context, zmq.DEALER, settings.endpoint("front"), identity="load", queue_length=100_000
        )
        self._read = wire.reader_of_many(m.BrokerToClient)
        self._socket.send_multipart(wire.frames(m.ClientHello(protocol=VERSION, client="load", abilities=[ARRAYS])))
        self._numbers = count(1)
        self._sent_at_s: dict[str, float] = {}
        self.outcomes: Counter[OutcomeKind] = Counter()
        self.latencies_s: list[float] = []  # of the commands that ended since the list was cleared

    def run(self, for_s: float) -> float:
        """Keep the window full for this time; returns the commands per second that ended."""
        began = time.monotonic()
        ended = 0
        while (now := time.monotonic()) - began < for_s:
            self._fill(now)
            ended += self._receive()
        return ended / (now - began)

    def finish(self, how_many: int) -> Iterator[int]:
        """Run this many commands; yields the number done from time to time."""
        left, done = how_many, 0
        while done < how_many:
            left -= self._fill(time.monotonic(), left)
            done += self._receive()
            yield done

    def drain(self) -> None:
        """Wait until no sentence is in progress."""
        while self._sent_at_s:
            self._receive()

    def status(self) -> m.Status:
        """The broker's status; only while no sentence is in progress."""
        assert not self._sent_at_s
        self._socket.send_multipart(wire.frames(m.StatusQuery(request="status")))
        while True:
            for reply in self._read(self._socket.recv_multipart()):
                if isinstance(reply, m.StatusReply):
                    return reply.status
                assert isinstance(reply, m.Welcome), reply

    def close(self) -> None:
        self._context.destroy(linger=0)

    def __enter__(self) -> LoadClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _fill(self, now: float, at_most: int = 1 << 60) -> int:
        new = min(self._window - len(self._sent_at_s), at_most)
        sentences = []
        for _ in range(new):
            n = next(self._numbers)
            request = str(n)
            self._sent_at_s[request] = now
            sentences.append(m.CommandText(request=request, text=self._text(n), progress=False, sent_at_s=now))
        for parts in wire.together(sentences):
            self._socket.send_multipart(parts)
        return new

    def _receive(self) -> int:
        """Receive; the number of commands that ended. Raises Stuck."""
        if not self._socket.poll(int(STUCK_S * 1000)):
            raise Stuck(f"no message for {STUCK_S} s, {len(self._sent_at_s)} commands in progress")
        now, ended = time.monotonic(), 0
        for parts in inbox(self._socket):
            for message in self._read(parts):
                if isinstance(message, m.CommandEnded):
                    self.latencies_s.append(now - self._sent_at_s.pop(message.request))
                    self.outcomes[message.outcome.kind] += 1
                    ended += 1
                elif not isinstance(message, (m.Accepted, m.Welcome)):
                    raise RuntimeError(f"the cluster answers a sentence with {message}")
        return ended
