"""Discrete-event simulation: a clock with an event queue, and hosts whose cores are shared by their processes. Pure."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from typing import Any

Act = Callable[..., None]
NORMAL, NICE_5 = 1024.0, 335.0  # weights of the Linux scheduler at niceness 0 and 5
REAL_TIME = math.inf  # runs before all others


class Simulation:
    """`now_s` jumps from event to event. Events of the same time occur in the order in which they were scheduled."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.events = 0  # that have occurred
        self._heap: list[tuple[float, int, Act, tuple[Any, ...]]] = []
        self._count = 0

    def after(self, wait_s: float, act: Act, *about: Any) -> None:
        self._count += 1
        heapq.heappush(self._heap, (self.now_s + wait_s, self._count, act, about))

    def run(self, until_s: float) -> None:
        heap = self._heap
        while heap and heap[0][0] <= until_s:
            self.now_s, _, act, about = heapq.heappop(heap)
            self.events += 1
            act(*about)
        self.now_s = until_s


class Host:
    """Cores that are shared by weight among the tasks that can run; a task uses one core at most.

    Real-time tasks have a core each before the others. `cores` None: each task has a core of its own.
    """

    def __init__(self, sim: Simulation, cores: int | None = None) -> None:
        self._sim, self._cores = sim, cores
        self._tasks: list[_Task] = []
        self._at_s = 0.0  # time up to which the tasks have been advanced
        self._round = 0  # number of the latest plan; the events of earlier plans are void

    @property
    def limited(self) -> bool:
        return self._cores is not None

    def work(self, weight: float, demand_s: float, act: Act, *about: Any) -> None:
        """Call `act` when a task with this demand of processor time (s) is complete."""
        if self._cores is None:
            self._sim.after(demand_s, act, *about)
            return
        self._advance()
        self._tasks.append(_Task(weight, demand_s, act, about))
        self._plan()

    def _advance(self) -> None:
        elapsed_s, self._at_s = self._sim.now_s - self._at_s, self._sim.now_s
        if elapsed_s > 0.0:
            for task in self._tasks:
                task.left_s -= elapsed_s * task.rate

    def _plan(self) -> None:
        """Set the rates, and schedule the next completion."""
        assert self._cores is not None
        set_rates(self._tasks, self._cores)
        self._round += 1
        next_s = min((task.left_s / task.rate for task in self._tasks if task.rate > 0.0), default=None)
        if next_s is not None:
            self._sim.after(max(0.0, next_s), self._complete, self._round)

    def _complete(self, number: int) -> None:
        if number != self._round:
            return
        self._advance()
        done = [task for task in self._tasks if task.left_s <= 1e-12]
        self._tasks = [task for task in self._tasks if task.left_s > 1e-12]
        self._plan()
        for task in done:
            task.act(*task.about)


class _Task:
    __slots__ = ("about", "act", "left_s", "rate", "weight")

    def __init__(self, weight: float, left_s: float, act: Act, about: tuple[Any, ...]) -> None:
        self.weight, self.left_s, self.act, self.about = weight, left_s, act, about
        self.rate = 0.0  # share of a core


def set_rates(tasks: list[_Task], cores: int) -> None:
    """Share the cores: one to each real-time task, the rest by weight, at most one core per task."""
    left = float(cores)
    normal = []
    for task in tasks:
        if task.weight == REAL_TIME:
            task.rate = min(1.0, left)
            left -= task.rate
        else:
            normal.append(task)
    normal.sort(key=lambda task: -task.weight)
    weight = sum(task.weight for task in normal)
    for task in normal:  # the heaviest first: what it cannot use is left for the others
        task.rate = min(1.0, left * task.weight / weight) if left > 0.0 else 0.0
        left -= task.rate
        weight -= task.weight
