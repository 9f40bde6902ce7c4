"""When the next tick is due, and whether it came late. Pure: the caller reads the clock and sleeps.

Simulated time runs `speed` times as fast as the clock on the wall; speed 0 is as fast as the machine can while there is
something to do, and 1 while there is not, so that an idle simulator leaves the cores to others.
"""

from __future__ import annotations

from sim_mcm.arm import TICK_S

CATCH_UP_S = 0.05  # what is lost beyond this (a stopped process, a stalled machine) is not made up for


class Clock:
    def __init__(self, speed: float, now_s: float) -> None:
        assert speed >= 0.0, speed
        self.speed = speed
        self.ticks = 0
        self.late_ticks = 0  # begun more than one period after they were due
        self._due_s = now_s
        self._free_running = False

    @property
    def sim_s(self) -> float:
        return self.ticks * TICK_S

    def left_s(self, now_s: float, busy: bool) -> float:
        """How long to sleep before the next tick; 0 = begin it."""
        self._free_running = self.speed == 0.0 and busy
        return 0.0 if self._free_running else max(0.0, self._due_s - now_s)

    def begin(self, now_s: float) -> None:
        """A tick begins."""
        self.ticks += 1
        if self._free_running:
            self._due_s = now_s
            return
        period_s = TICK_S / (self.speed or 1.0)
        late_s = now_s - self._due_s
        if late_s > period_s:
            self.late_ticks += 1
        if late_s > max(CATCH_UP_S, 2 * period_s):
            self._due_s = now_s
        self._due_s += period_s
