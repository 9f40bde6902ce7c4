"""Halts of pages: several lines to broker and MCM, each with sockets of its own.

A line is busy until rest is confirmed. The lines are shared out among three kinds of scope, so that no halt of all
waits for one of a command. Of orders of the same scope one waits at most, which is sent as the newest: later ones join
it, and get its result. A line sends no more orders than the subsystems confirm (`PER_S`), whatever pages send.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import msgspec

from rtc.client.context import ClientContext
from rtc.client.halt import HaltLine, HaltResult, OnRest, SubsystemHalt
from rtc.language.fastpath import EVERYTHING, named_scope
from rtc.protocol.outcomes import ClusterError
from rtc.runtime.halt_admission import PER_S
from rtc.runtime.keys import Endpoints

TIMEOUT_S = 2.0
PACE_S = 1.1 / PER_S  # between two orders of a line
MAX_WAITING = 32  # different scopes of one kind that wait


OnNews = Callable[[dict[str, Any]], None]  # what rests already, while the result is awaited


class _Asked(msgspec.Struct):
    """An order that waits for a line, or for rest: its result and its news for all who have asked."""

    found: asyncio.Future[dict[str, Any]]
    news: list[OnNews] = []


class _Lines(msgspec.Struct):
    """The lines of one kind of scope. `waiting`: scope -> what was asked, the oldest first."""

    free: list[HaltLine]
    waiting: dict[str, _Asked] = {}


class HaltLines:
    """For one event loop. `arms`: names of arms."""

    def __init__(self, endpoints: Endpoints, arms: Collection[str], round_trip_s: float = 0.0) -> None:
        self._context, self._round_trip_s = ClientContext(), round_trip_s
        self._arms = set(arms)
        lines = [HaltLine(self._context, endpoints) for _ in range(6)]
        self._all = lines
        self._everything, self._arm, self._other = (_Lines(free) for free in (lines[:3], lines[3:5], lines[5:]))
        self._threads = ThreadPoolExecutor(len(lines), thread_name_prefix="halt")

    async def order(self, scope: str, on_news: OnNews | None = None) -> dict[str, Any]:
        """The result as JSON types; `error` if no process was reached. `took_s`: since the order was sent. `on_news`
        is called with what rests already while others do not: `name`, `rest_s`, `awaited`."""
        scope = named_scope(scope)
        lines = self._everything if scope == EVERYTHING else self._arm if scope in self._arms else self._other
        if scope not in lines.waiting:
            if len(lines.waiting) >= MAX_WAITING:
                return {"error": f"{MAX_WAITING} other halts wait; HALT ALL does not wait for them"}
            lines.waiting[scope] = _Asked(asyncio.get_running_loop().create_future())
        asked = lines.waiting[scope]
        if on_news is not None:
            asked.news.append(on_news)
        self._send(lines)
        return await asyncio.shield(asked.found)  # others may have asked for it

    def close(self) -> None:
        self._threads.shutdown(wait=True, cancel_futures=True)
        for line in self._all:
            line.close()
        self._context.destroy(linger=0)

    def _send(self, lines: _Lines) -> None:
        while lines.free and lines.waiting:
            scope = next(iter(lines.waiting))
            line, asked = lines.free.pop(), lines.waiting.pop(scope)
            loop = asyncio.get_running_loop()
            sent = loop.run_in_executor(self._threads, self._halt, line, scope, partial(_report, loop, asked))
            sent.add_done_callback(partial(self._ended, lines, line, asked.found))

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

    def _halt(self, line: HaltLine, scope: str, on_rest: OnRest) -> dict[str, Any]:
        sent_s = time.monotonic()
        try:
            found = as_json(line.halt(scope, TIMEOUT_S + self._round_trip_s, self._round_trip_s, on_rest))
        except ClusterError as error:
            found = {"error": str(error)}
        return {**found, "took_s": time.monotonic() - sent_s}


def _report(loop: asyncio.AbstractEventLoop, asked: _Asked, found: SubsystemHalt, awaited: list[str]) -> None:
    """From the thread of a line."""
    for report in asked.news:
        loop.call_soon_threadsafe(report, {"name": found.name, "rest_s": found.rest_s, "awaited": awaited})


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
        "unknown": result.unknown,
    }
