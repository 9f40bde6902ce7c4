"""Discrete-event simulation: a clock with an event queue, and hosts whose cores are shared by their processes. Pure."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from typing import Any

Act = Callable[..., None]
NORMAL, REAL_TIME = False, True  # priorities


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
    """Cores that run tasks in the order of their arrival, each on one core until its end.

    As Linux does: a task runs on for a slice of some milliseconds, and the tasks of this model are shorter. A real-time
    task stays on its core and interrupts what runs there; that task waits, although another core may be idle.
    `cores` None: each task has a core of its own.
    """

    def __init__(self, sim: Simulation, cores: int | None = None) -> None:
        self._sim, self._cores = sim, cores
        self._tasks: list[_Task] = []
        self._at_s = 0.0  # time up to which the tasks have been advanced
        self._round = 0  # number of the latest plan; the events of earlier plans are void

    @property
    def limited(self) -> bool:
        return self._cores is not None

    def work(self, real_time: bool, demand_s: float, act: Act, *about: Any) -> None:
        """Call `act` when a task with this demand of processor time (s) is complete."""
        if self._cores is None:
            self._sim.after(demand_s, act, *about)
            return
        self._advance()
        self._tasks.append(_Task(real_time, demand_s, act, about))
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
    __slots__ = ("about", "act", "core", "left_s", "rate", "real_time")

    def __init__(self, real_time: bool, left_s: float, act: Act, about: tuple[Any, ...]) -> None:
        self.real_time, self.left_s, self.act, self.about = real_time, left_s, act, about
        self.rate = 0.0  # share of a core: 0 or 1
        self.core: int | None = None  # where it has begun


def set_rates(tasks: list[_Task], cores: int) -> None:
    """Real-time tasks run on the first cores. Others stay on the core where they began, and begin on a free one."""
    urgent = [task for task in tasks if task.real_time]
    for core, task in enumerate(urgent):
        task.rate = 1.0 if core < cores else 0.0
    begun = {task.core for task in tasks if task.core is not None}
    free = [core for core in range(min(len(urgent), cores), cores) if core not in begun]
    for task in tasks:
        if not task.real_time:
            if task.core is None and free:
                task.core = free.pop(0)
            task.rate = 1.0 if task.core is not None and task.core >= len(urgent) else 0.0
