"""The pace of a primitive: how fast the time of its profile runs, so that a pause keeps the arm on its path. Pure.

A pause lowers the rate of that time from 1 to 0, its end raises it again. Both ramps are smooth, and take as long as
the joints' acceleration limits need. An order during a ramp takes effect after it. This module must not know arms or
messages.

The same ramps keep the profile before a time that it may not reach yet (`keep_before`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np

from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import TICK_S, Motion
from rtc.subsystems.motion.profiles import Follow, Profile, smooth

RAMPS_S = (0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0, 1.5, 2.0)  # possible durations; the shortest within the limits is taken
CHECKED_S = 0.005  # distance of the checked times of a ramp
SLACK = 1.002  # of acceleration limits, for rounding
SAME_TICK = 1e-6  # of a tick, rounding of a duration


class PathRate:
    def __init__(self) -> None:
        self.paused = False  # the latest order
        self.rate, self.change = 1.0, 0.0  # profile time per time, and its derivative (1/s)
        self.full = True  # the profile runs at its own pace, and is to go on so
        self._least_s = 0.0  # minimum duration of a ramp
        self._ticks_left = self._ticks = 0  # of the present ramp
        self._begin = 1.0
        self.held = False  # it is to stand, because it may not come to `_before_s` yet
        self._before_s = math.inf  # of the profile
        self._brake_at_s = math.inf  # latest begin of the ramp for it
        self._rise = (math.nan, 0.0)  # a time at which the profile stands, and the way of a rise from there (s)

    def order(self, paused: bool, least_s: float) -> None:
        """Pause, or go on, within this time or more (s)."""
        self.paused, self._least_s = paused, least_s
        self._compare()

    def _compare(self) -> None:
        self.full = self.rate == 1.0 and not (self.paused or self.held) and not self._ticks_left

    def keep_before(self, before_s: float, profile: Profile, at_s: float, most_rad_s2: Sequence[float]) -> None:
        """Let the profile, which is at `at_s` now, not come beyond `before_s`: it stands before that.

        Call it in each tick, with times that do not decrease; infinite: it goes on. It brakes as late as the limits
        allow, and does not rise for so short a way that it could not stand again."""
        if before_s != self._before_s:
            self._before_s, self._brake_at_s = before_s, _brake_at_s(profile, before_s, most_rad_s2)
        if self._ticks_left:
            return  # a rise ends before the time to brake
        if self.rate == 1.0:
            self.held = at_s + TICK_S > self._brake_at_s
        else:
            if self._rise[0] != at_s:
                self._rise = at_s, 0.5 * _ramp_s(profile, at_s, 0.0, most_rad_s2)
            self.held = at_s + self._rise[1] + TICK_S > self._brake_at_s
        self._compare()

    def advance(self, profile: Profile, at_s: float, most_rad_s2: Sequence[float]) -> float:
        """One tick: returns the progress (s) of the profile's time, which is `at_s` now."""
        target = 0.0 if self.paused or self.held else 1.0
        if not self._ticks_left:
            if self.rate == target:
                return self.rate * TICK_S
            self._begin = self.rate
            ramp_s = max(self._least_s, _ramp_s(profile, at_s, self.rate, most_rad_s2))
            if target == 0.0:  # it progresses by half of its duration
                ramp_s = min(ramp_s, max(0.0, 2.0 * (self._before_s - at_s)))
            self._ticks = self._ticks_left = max(1, math.floor(ramp_s / TICK_S + SAME_TICK))
        before_s = self._progress_s()
        self._ticks_left -= 1
        progress_s = self._progress_s() - before_s
        end, length_s = 1.0 - self._begin, self._ticks * TICK_S
        if self._ticks_left:
            part, slope, _ = smooth(1.0 - self._ticks_left / self._ticks)
            self.rate = self._begin + (end - self._begin) * part
            self.change = (end - self._begin) * slope / length_s
        else:
            self.rate, self.change = end, 0.0
            self._compare()
        return progress_s

    def next_ramp_s(self, profile: Profile, at_s: float, most_rad_s2: Sequence[float]) -> float:
        """Duration of the next ramp; its longest one if another ramp comes before."""
        return RAMPS_S[-1] if self._ticks_left else _ramp_s(profile, at_s, self.rate, most_rad_s2)

    def scaled(self, motion: Motion) -> Motion:
        """The motion of the profile at the present rate."""
        joints, velocities, accelerations = motion
        rate, change = self.rate, self.change
        slower = [rate * v for v in velocities]
        return joints, slower, [rate * rate * a + change * v for v, a in zip(velocities, accelerations, strict=True)]

    def _progress_s(self) -> float:
        """Profile time since the begin of the ramp."""
        length_s = self._ticks * TICK_S
        x = 1.0 - self._ticks_left / self._ticks
        return self._begin * x * length_s + (1.0 - 2.0 * self._begin) * length_s * _integral(x)


def _integral(x: float) -> float:
    """Integral of the smooth step from 0 to x."""
    return x**4 * (2.5 + x * (x - 3.0))


@cache
def _shape(count: int) -> tuple[Array, Array, Array, Array]:
    """Of a smooth step in so many intervals: where, and its value, slope and integral there."""
    shares: Array = np.linspace(0.0, 1.0, count + 1)
    steps = [(*smooth(x)[:2], _integral(x)) for x in shares.tolist()]
    part, slope, integral = np.array(steps).T
    return shares, part, slope, integral


def _brake_at_s(profile: Profile, before_s: float, most_rad_s2: Sequence[float]) -> float:
    """The latest time at which a ramp within the limits begins that ends before this time of the profile."""
    if math.isinf(before_s):
        return math.inf
    starts = [before_s - 0.5 * length_s for length_s in RAMPS_S]
    for at_s, length_s in zip(starts, RAMPS_S, strict=True):
        if _ramp_s(profile, max(0.0, at_s), 1.0, most_rad_s2) <= length_s:
            return at_s
    return starts[-1]


def _ramp_s(profile: Profile, at_s: float, begin: float, most_rad_s2: Sequence[float]) -> float:
    """Duration of the ramp from the rate `begin` (0 or 1) to the other."""
    if not isinstance(profile, Follow):
        return TICK_S  # nothing moves
    most = np.asarray(most_rad_s2)
    for length_s in RAMPS_S:
        shares, part, slope, integral = _shape(round(length_s / CHECKED_S))
        towards = 1.0 - 2.0 * begin
        rate, change = begin + towards * part, towards * slope / length_s
        progress_s = length_s * (begin * shares + towards * integral)
        motions = profile.path(at_s + progress_s)
        speeds, own = motions[:, 1], motions[:, 2]
        needed = (rate**2)[:, None] * own + change[:, None] * speeds
        if (np.abs(needed).max(axis=0) <= SLACK * np.maximum(most, np.abs(own).max(axis=0))).all():
            return length_s
    return RAMPS_S[-1]
