"""One broker's queues and its assignment of jobs, by the rules of `broker.dispatch.worker_registry`. Pure.

The broker looks at all workers for each assignment; here a heap finds the same worker, so that large cubes can be
simulated. A test compares both.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator
from typing import Any

from broker.dispatch.worker_registry import BATCH_MAX, BATCH_S, SLOW_S

KINDS = 4


class Slot:
    """A worker as one broker sees it."""

    __slots__ = ("assigned", "done", "index", "mean_s", "worker")

    def __init__(self, worker: Any, index: int) -> None:
        self.worker, self.index = worker, index
        self.assigned = self.done = 0
        self.mean_s = 1.0

    @property
    def batch_size(self) -> int:
        return max(1, min(BATCH_MAX, int(BATCH_S / max(self.mean_s, 1e-6))))

    @property
    def free_slots(self) -> int:
        return (1 if self.mean_s > SLOW_S else 2 * self.batch_size) - self.assigned


class Registry:
    """`workers`: of all kinds, in the order of their addresses; the two low bits of the address give the kind."""

    def __init__(self, workers: list[tuple[int, Any]]) -> None:
        self.count = len(workers)
        self.queues: list[deque[Any]] = [deque() for _ in range(KINDS)]
        self._slots: list[list[Slot]] = [[] for _ in range(KINDS)]
        for address, worker in workers:
            slots = self._slots[address % KINDS]
            slots.append(Slot(worker, len(slots)))
        self._free = [[(0, slot.index) for slot in slots] for slots in self._slots]  # heaps; entries may be outdated

    def slot(self, kind: int, index: int) -> Slot:
        return self._slots[kind][index]

    def assign(self) -> Iterator[tuple[int, Slot, list[Any]]]:
        """Assign queued jobs, to the least loaded worker first. Yields (kind, worker, jobs)."""
        for kind, queue in enumerate(self.queues):
            free, slots = self._free[kind], self._slots[kind]
            while queue and free:
                assigned, index = free[0]
                slot = slots[index]
                if slot.assigned != assigned or slot.free_slots <= 0:
                    heapq.heappop(free)
                    continue
                jobs = [queue.popleft() for _ in range(min(slot.batch_size, slot.free_slots, len(queue)))]
                slot.assigned += len(jobs)
                heapq.heapreplace(free, (slot.assigned, index))
                yield kind, slot, jobs

    def answered(self, kind: int, slot: Slot, took_s: float) -> None:
        slot.assigned -= 1
        slot.done += 1
        slot.mean_s = took_s if slot.done == 1 else 0.8 * slot.mean_s + 0.2 * took_s
        heapq.heappush(self._free[kind], (slot.assigned, slot.index))
