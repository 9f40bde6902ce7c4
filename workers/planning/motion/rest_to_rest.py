"""Time-optimal jerk-limited profile for one length from rest to rest, in closed form.

Seven pieces of constant jerk: ramp up, constant acceleration, ramp down, cruise, and the reverse. Independent of arm
and path. A searching solver (ruckig) fails at round figures, such as 10 mm at 0.5 m/s^2, where two of its cases meet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rtc.spatial.geometry import Array

PIECES = 7  # of a profile
MIN_PIECE_S = 1e-5  # a shorter piece is joined to the one before it: it changes nothing above 1e-9 rad


@dataclass(frozen=True, eq=False)
class JerkProfile:
    """Pieces of constant jerk with start time (s) and initial position, speed and acceleration. Any unit of length."""

    duration_s: float
    since_s: Array
    begins: Array  # [pieces][position, speed, acceleration, jerk]

    @property
    def knots_s(self) -> Array:
        """The ends of the pieces. Quintic Hermite polynomials between them equal the profile: each piece is a cubic."""
        ends = np.append(self.since_s, self.duration_s)
        return np.append(ends[:-1][np.diff(ends) > MIN_PIECE_S], self.duration_s)

    def at(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Position, speed and acceleration at each time."""
        piece = np.clip(np.searchsorted(self.since_s, time_s, side="right") - 1, 0, len(self.since_s) - 1)
        t = time_s - self.since_s[piece]
        place, speed, acceleration, jerk = self.begins[piece].T
        return (
            place + t * (speed + t * (acceleration / 2 + t * jerk / 6)),
            speed + t * (acceleration + t * jerk / 2),
            acceleration + t * jerk,
        )


def rest_to_rest(length: float, speed: float, acceleration: float, jerk: float) -> JerkProfile:
    """The time-optimal profile over `length`; all four arguments must be positive."""
    assert min(length, speed, acceleration, jerk) > 0.0, (length, speed, acceleration, jerk)
    peak = min(speed, _highest_peak(length, acceleration, jerk))
    ramp_s = min(acceleration / jerk, math.sqrt(peak / jerk))
    even_s = max(0.0, peak / (jerk * ramp_s) - ramp_s)
    cruise_s = max(0.0, length / peak - (2 * ramp_s + even_s))
    lasts = np.array([ramp_s, even_s, ramp_s, cruise_s, ramp_s, even_s, ramp_s])
    jerks = jerk * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0])
    begins, now = [], (0.0, 0.0, 0.0)
    for t, j in zip(lasts.tolist(), jerks.tolist(), strict=True):
        place, v, a = now
        begins.append((place, v, a, j))
        now = (place + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2), a + t * j)
    return JerkProfile(float(lasts.sum()), np.cumsum(lasts) - lasts, np.array(begins))


def _highest_peak(length: float, acceleration: float, jerk: float) -> float:
    """Peak speed of a profile without cruise: half acceleration, half deceleration."""
    ramp_s = acceleration / jerk
    without_even = (length / 2) ** (2 / 3) * jerk ** (1 / 3)
    if without_even <= acceleration * ramp_s:
        return without_even
    return acceleration * (math.sqrt(ramp_s**2 + 4 * length / acceleration) - ramp_s) / 2
