"""The loop of `rtc observe`: passes what a feed receives to metrics and traces. May be killed at any time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from rtc.apps.observers.feed import Feed, Received
from rtc.runtime.process import Process, now_s

WAIT_S = 0.25


class Watcher(Protocol):
    def take(self, received: Received) -> None: ...

    def close(self) -> None: ...


def observe(me: Process, feed: Feed, watchers: Sequence[Watcher], for_s: float = math.inf) -> None:
    """Pass on what arrives until `me.stopping`, the end of the cluster, or `for_s`."""
    until_s = now_s() + for_s
    while not me.stopping and not feed.over() and now_s() < until_s:
        for received in feed.read(min(WAIT_S, max(0.0, until_s - now_s()))):
            for watcher in watchers:
                watcher.take(received)
