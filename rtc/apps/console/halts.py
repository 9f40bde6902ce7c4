"""Halts of pages: several lines to broker and MCM, each with sockets of its own, so that no halt waits for another."""

from __future__ import annotations

import asyncio
import time
from concurrent.futures import ThreadPoolExecutor
from queue import Empty, SimpleQueue
from typing import Any

from rtc.client.context import ClientContext
from rtc.client.halt import HaltLine, HaltResult
from rtc.protocol.outcomes import ClusterError
from rtc.runtime.keys import Endpoints

LINES = 4  # halts under way at once; a line is busy until rest is confirmed
TIMEOUT_S = 2.0


class Halts:
    """`halt` may be called from any thread; `order` from the event loop."""

    def __init__(self, endpoints: Endpoints, round_trip_s: float = 0.0) -> None:
        self._context, self._round_trip_s = ClientContext(), round_trip_s
        self._lines: SimpleQueue[HaltLine] = SimpleQueue()
        self._all = [HaltLine(self._context, endpoints) for _ in range(LINES)]
        for line in self._all:
            self._lines.put(line)
        self._threads = ThreadPoolExecutor(LINES + 1, thread_name_prefix="halt")

    async def order(self, scope: str) -> dict[str, Any]:
        """The result as JSON types; `error` if no process was reached."""
        received_s = time.monotonic()
        found = await asyncio.get_running_loop().run_in_executor(self._threads, self.halt, scope)
        return {**found, "took_s": time.monotonic() - received_s}

    def halt(self, scope: str) -> dict[str, Any]:
        try:
            line = self._lines.get(timeout=TIMEOUT_S)
        except Empty:  # all lines wait for rest: this order has been sent as often
            return {"error": "all halt lines wait for rest; the orders before have been sent"}
        try:
            return as_json(line.halt(scope, TIMEOUT_S + self._round_trip_s, self._round_trip_s))
        except ClusterError as error:
            return {"error": str(error)}
        finally:
            self._lines.put(line)

    def close(self) -> None:
        self._threads.shutdown(wait=True, cancel_futures=True)
        for line in self._all:
            line.close()
        self._context.destroy(linger=0)


def as_json(result: HaltResult) -> dict[str, Any]:
    """What a page shows of a halt. Times in s from the call."""
    rests = [sub.rest_s for sub in result.subsystems if sub.rest_s is not None]
    return {
        "halt": result.halt,
        "scope": result.scope,
        "latency_s": result.latency_s,
        "rest_s": max(rests, default=None),
        "confirmed": result.confirmed,
        "moving": result.moving,
        "sent_to": result.sent_to,
        "message": result.message,
        "declined": result.declined,
    }
