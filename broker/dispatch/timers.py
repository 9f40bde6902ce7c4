"""Named timers in order of expiry. Pure: the time is an argument.

A new timer replaces the one of the same name. A timer may count the own time of subsystems, such as simulated time:
then it waits for the slowest of them too. So a subsystem that a busy machine slows down is not late, and one that
stands still is (it gives no sign of life at all; `broker.router.health`).
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import msgspec

DEAD_KEPT = 1_000  # entries of the heap that no longer count, before it is made anew
MAX_SLOWED = 60.0  # a subsystem slower than this, as a factor, is late nevertheless
LOOK_AGAIN_S = 0.1  # least time between two looks at the same timer; signs of life arrive every 0.25 s


class Count(msgspec.Struct, frozen=True, gc=False):
    """What a timer counts beyond our clock."""

    limit_s: float
    own_s: dict[str, float | None]  # own time of each subsystem at the start; None: not known yet
    latest_s: float  # on our clock


class Timers:
    """`scale`: seconds of ours per second of a subsystem's own time."""

    def __init__(self, scale: float = 1.0) -> None:
        self._scale = scale
        self._at: dict[str, float] = {}
        self._heap: list[tuple[float, str]] = []  # may hold times that no longer count
        self._counts: dict[str, Count] = {}
        self._own_s: dict[str, float] = {}  # subsystem -> its own time, as it last reported it

    def set_own_time(self, subsystem: str, own_s: float) -> None:
        """A subsystem reports its own time (s)."""
        self._own_s[subsystem] = own_s * self._scale

    def start(self, name: str, at_s: float, now: float = 0.0, subsystems: Sequence[str] = ()) -> None:
        """`subsystems`: count their own time since `now` too; those that report none count our time only."""
        self._put(name, at_s)
        if subsystems:
            limit_s, own_s = at_s - now, self._own_s
            self._counts[name] = Count(limit_s, {one: own_s.get(one) for one in subsystems}, now + MAX_SLOWED * limit_s)
        elif name in self._counts:
            del self._counts[name]

    def stop(self, name: str) -> None:
        self._at.pop(name, None)
        if name in self._counts:
            del self._counts[name]

    def next_at_s(self) -> float | None:
        while self._heap and self._at.get(self._heap[0][1]) != self._heap[0][0]:
            heapq.heappop(self._heap)
        return self._heap[0][0] if self._heap else None

    def due(self, now: float) -> list[str]:
        names = []
        while (at_s := self.next_at_s()) is not None and at_s <= now:
            name = heapq.heappop(self._heap)[1]
            if (left_s := self._left_s(name, now)) > 0.0:
                self._put(name, now + max(LOOK_AGAIN_S, left_s))
                continue
            names.append(name)
            self.stop(name)
        return names

    def _put(self, name: str, at_s: float) -> None:
        self._at[name] = at_s
        heapq.heappush(self._heap, (at_s, name))
        if len(self._heap) > DEAD_KEPT + 2 * len(self._at):  # most timers are stopped before they ring
            self._heap = [(at_s, name) for name, at_s in self._at.items()]
            heapq.heapify(self._heap)

    def _left_s(self, name: str, now: float) -> float:
        """How much of its time the slowest subsystem still has (s), by its own time; 0: none."""
        count = self._counts.get(name)
        if count is None or now >= count.latest_s:
            return 0.0
        left_s = 0.0
        for subsystem, began_s in count.own_s.items():
            own_s = self._own_s.get(subsystem)
            if own_s is None:
                continue
            if began_s is None or own_s < began_s:  # it has connected since, or is another process
                count.own_s[subsystem] = began_s = own_s
            left_s = max(left_s, count.limit_s - (own_s - began_s))
        return min(left_s, count.latest_s - now)
