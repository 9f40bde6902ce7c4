"""Halts of pages: several lines to broker and MCM, each with sockets of its own.

A line is busy until rest is confirmed. The lines are shared out among three kinds of scope, so that no halt of all
waits for one of a command. Of orders of the same scope one waits at most, which is sent as the newest: later ones join
it, and get its result. A line sends no more orders than the subsystems confirm (`PER_S`), whatever pages send.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import msgspec

from rtc.client.context import ClientContext
from rtc.client.halt import HaltLine, HaltResult
from rtc.language.fastpath import EVERYTHING, halt_scope
from rtc.protocol.outcomes import ClusterError
from rtc.runtime.halt_admission import PER_S
from rtc.runtime.keys import Endpoints

TIMEOUT_S = 2.0
PACE_S = 1.1 / PER_S  # between two orders of a line
MAX_WAITING = 32  # different scopes of one kind that wait


class _Lines(msgspec.Struct):
    """The lines of one kind of scope. `waiting`: scope -> the result for all who have asked, the oldest first."""

    free: list[HaltLine]
    waiting: dict[str, asyncio.Future[dict[str, Any]]] = {}


class Halts:
    """For one event loop. `arms`: names of arms."""

    def __init__(self, endpoints: Endpoints, arms: Collection[str], round_trip_s: float = 0.0) -> None:
        self._context, self._round_trip_s = ClientContext(), round_trip_s
        self._arms = set(arms)
        lines = [HaltLine(self._context, endpoints) for _ in range(6)]
        self._all = lines
        self._everything, self._arm, self._other = (_Lines(free) for free in (lines[:3], lines[3:5], lines[5:]))
        self._threads = ThreadPoolExecutor(len(lines), thread_name_prefix="halt")

    async def order(self, scope: str) -> dict[str, Any]:
        """The result as JSON types; `error` if no process was reached. `took_s`: since the order was sent."""
        scope = halt_scope(f"HALT {scope}") or scope.upper()
        lines = self._everything if scope == EVERYTHING else self._arm if scope in self._arms else self._other
        if scope not in lines.waiting:
            if len(lines.waiting) >= MAX_WAITING:
                return {"error": f"{MAX_WAITING} other halts wait; HALT ALL does not wait for them"}
            lines.waiting[scope] = asyncio.get_running_loop().create_future()
        found = lines.waiting[scope]
        self._send(lines)
        return await asyncio.shield(found)  # others may have asked for it

    def close(self) -> None:
        self._threads.shutdown(wait=True, cancel_futures=True)
        for line in self._all:
            line.close()
        self._context.destroy(linger=0)

    def _send(self, lines: _Lines) -> None:
        while lines.free and lines.waiting:
            scope = next(iter(lines.waiting))
            line, found = lines.free.pop(), lines.waiting.pop(scope)
            sent = asyncio.get_running_loop().run_in_executor(self._threads, self._halt, line, scope)
            sent.add_done_callback(partial(self._ended, lines, line, found))

    def _ended(
        self,
        lines: _Lines,
        line: HaltLine,
        found: asyncio.Future[dict[str, Any]],
        sent: asyncio.Future[dict[str, Any]],
    ) -> None:
        if sent.cancelled():  # the console ends
            found.cancel()
            return
        found.set_result(sent.result())
        asyncio.get_running_loop().call_later(PACE_S - sent.result()["took_s"], self._freed, lines, line)

    def _freed(self, lines: _Lines, line: HaltLine) -> None:
        lines.free.append(line)
        self._send(lines)

    def _halt(self, line: HaltLine, scope: str) -> dict[str, Any]:
        sent_s = time.monotonic()
        try:
            found = as_json(line.halt(scope, TIMEOUT_S + self._round_trip_s, self._round_trip_s))
        except ClusterError as error:
            found = {"error": str(error)}
        return {**found, "took_s": time.monotonic() - sent_s}


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
