"""Tick schedule: when the next tick is due, and how many ticks were late. Pure: the caller reads the clock and sleeps.

Simulated time runs `speed` times as fast as wall time. Speed 0 means as fast as possible while a primitive runs, and
speed 1 otherwise. So an idle simulator leaves the cores to other processes.
"""

from __future__ import annotations

from rtc.subsystems.motion.arm import TICK_S

CATCH_UP_S = 0.05  # a longer delay (stopped process, stalled machine) is not caught up
# An overload: so much more time than the forgiven part of it was not caught up. One long delay alone is none.
OVERLOAD_S, FORGIVEN, MAX_COUNTED_S = 0.3, 0.01, 0.1


class Clock:
    def __init__(self, speed: float, now_s: float) -> None:
        assert speed >= 0.0, speed
        self.speed = speed
        self.ticks = 0
        self.late_ticks = 0  # ticks that began more than one period after they were due
        self._due_s = now_s
        self.free_running = False
        self._lost_s, self._lost_at_s = 0.0, now_s  # not caught up and not forgiven; when it was counted last

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
            self._due_s = now_s
            self._lose(late_s, now_s)
        self._due_s += period_s

    def overloaded(self) -> bool:
        """True once after the speed has not been kept for some time."""
        found = self._lost_s > OVERLOAD_S
        if found:
            self._lost_s = 0.0
        return found

    def _lose(self, late_s: float, now_s: float) -> None:
        self._lost_s = max(0.0, self._lost_s - FORGIVEN * (now_s - self._lost_at_s)) + min(late_s, MAX_COUNTED_S)
        self._lost_at_s = now_s
