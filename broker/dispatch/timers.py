"""Named timers in order of expiry. Pure: the time is an argument.

A new timer replaces the one of the same name.
"""

from __future__ import annotations

import heapq

DEAD_KEPT = 1_000  # entries of the heap that no longer count, before it is made anew


class Timers:
    def __init__(self) -> None:
        self._at: dict[str, float] = {}
        self._heap: list[tuple[float, str]] = []  # may hold times that no longer count

    def start(self, name: str, at_s: float) -> None:
        self._at[name] = at_s
        heapq.heappush(self._heap, (at_s, name))
        if len(self._heap) > DEAD_KEPT + 2 * len(self._at):  # most timers are stopped before they ring
            self._heap = [(at_s, name) for name, at_s in self._at.items()]
            heapq.heapify(self._heap)

    def stop(self, name: str) -> None:
        self._at.pop(name, None)

    def next_at_s(self) -> float | None:
        while self._heap and self._at.get(self._heap[0][1]) != self._heap[0][0]:
            heapq.heappop(self._heap)
        return self._heap[0][0] if self._heap else None

    def due(self, now: float) -> list[str]:
        names = []
        while (at_s := self.next_at_s()) is not None and at_s <= now:
            names.append(heapq.heappop(self._heap)[1])
            del self._at[names[-1]]
        return names
