"""Tick schedule: when the next tick is due, and how many ticks were late. Pure: the caller reads the clock and sleeps.

Simulated time runs `speed` times as fast as wall time. Speed 0 means as fast as possible while a primitive runs, and
speed 1 otherwise. So an idle simulator leaves the cores to other processes. A simulator that cannot keep its speed
pauses after each delay: with real-time priority, several of them would leave no core to those who command them.
"""

from __future__ import annotations

from sim_mcm.arms.arm import TICK_S

CATCH_UP_S = 0.05  # a longer delay (stopped process, stalled machine) is not caught up
PAUSE = 0.25  # pause after such a delay, as a part of it, ...
LONGEST_PAUSE_S = 0.025  # ... up to this: halts wait as long


class Clock:
    def __init__(self, speed: float, now_s: float) -> None:
        assert speed >= 0.0, speed
        self.speed = speed
        self.ticks = 0
        self.late_ticks = 0  # ticks that began more than one period after they were due
        self._due_s = now_s
        self.free_running = False

    @property
    def sim_s(self) -> float:
        return self.ticks * TICK_S

    def left_s(self, now_s: float, busy: bool) -> float:
        """Time to sleep before the next tick (s); 0 means to begin it now."""
        self.free_running = self.speed == 0.0 and busy
        return 0.0 if self.free_running else max(0.0, self._due_s - now_s)

    def begin(self, now_s: float) -> None:
        """Begin a tick: count it and schedule the next."""
        self.ticks += 1
        if self.free_running:
            self._due_s = now_s
            return
        period_s = TICK_S / (self.speed or 1.0)
        late_s = now_s - self._due_s
        if late_s > period_s:
            self.late_ticks += 1
        if late_s > max(CATCH_UP_S, 2 * period_s):
            self._due_s = now_s + min(PAUSE * late_s, LONGEST_PAUSE_S)
        self._due_s += period_s
