"""The pace of a primitive: how fast the time of its profile runs, so that a pause keeps the arm on its path. Pure.

A pause lowers the rate of that time from 1 to 0, its end raises it again. Both ramps are smooth, and take as long as
the joints' acceleration limits need. An order during a ramp takes effect after it. This module must not know arms or
messages.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import TICK_S, Motion
from rtc.subsystems.motion.profiles import Follow, Profile, smooth

RAMPS_S = (0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0, 1.5, 2.0)  # possible durations; the shortest within the limits is taken
CHECKED_S = 0.005  # distance of the checked times of a ramp
SLACK = 1.002  # of acceleration limits, for rounding


class PathRate:
    def __init__(self) -> None:
        self.paused = False  # the latest order
        self.rate, self.change = 1.0, 0.0  # profile time per time, and its derivative (1/s)
        self.full = True  # the profile runs at its own pace, and is to go on so
        self._least_s = 0.0  # minimum duration of a ramp
        self._ticks_left = self._ticks = 0  # of the present ramp
        self._begin = 1.0

    def order(self, paused: bool, least_s: float) -> None:
        """Pause, or go on, within this time or more (s)."""
        self.paused, self._least_s = paused, least_s
        self._compare()

    def _compare(self) -> None:
        self.full = self.rate == 1.0 and not self.paused and not self._ticks_left

    def advance(self, profile: Profile, at_s: float, most_rad_s2: Sequence[float]) -> float:
        """One tick: returns the progress (s) of the profile's time, which is `at_s` now."""
        target = 0.0 if self.paused else 1.0
        if not self._ticks_left:
            if self.rate == target:
                return self.rate * TICK_S
            self._begin = self.rate
            ramp_s = max(self._least_s, _ramp_s(profile, at_s, self.rate, most_rad_s2))
            self._ticks = self._ticks_left = round(ramp_s / TICK_S)
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


def _ramp_s(profile: Profile, at_s: float, begin: float, most_rad_s2: Sequence[float]) -> float:
    """Duration of the ramp from the rate `begin` (0 or 1) to the other."""
    if not isinstance(profile, Follow):
        return TICK_S  # nothing moves
    most = np.asarray(most_rad_s2)
    for length_s in RAMPS_S:
        times_s: Array = np.linspace(0.0, length_s, round(length_s / CHECKED_S) + 1)
        steps = [smooth(x) for x in (times_s / length_s).tolist()]
        part, slope = np.array([s[0] for s in steps]), np.array([s[1] for s in steps])
        towards = 1.0 - 2.0 * begin
        rate, change = begin + towards * part, towards * slope / length_s
        progress_s = begin * times_s + towards * length_s * np.array([_integral(x) for x in times_s / length_s])
        motions = profile.path(at_s + progress_s)
        speeds, own = motions[:, 1], motions[:, 2]
        needed = (rate**2)[:, None] * own + change[:, None] * speeds
        if (np.abs(needed).max(axis=0) <= SLACK * np.maximum(most, np.abs(own).max(axis=0))).all():
            return length_s
    return RAMPS_S[-1]
