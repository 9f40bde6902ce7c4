"""The time by which looks are limited. Pure: the time of our clock is an argument.

A picture of a simulated camera is drawn by this machine, which takes a third of a second when it is idle and half a
minute when it is busy. A limit of a look guards against a camera that gives nothing, so a picture under way counts as
long as it takes on an idle machine, and no longer. One that never comes is ended by who makes it.
"""

from __future__ import annotations

PICTURE_S = 1.0  # most that one picture counts


class LookClock:
    """`scale`: our seconds per second of the simulation, in which limits are stated."""

    def __init__(self, scale: float = 1.0) -> None:
        self._scale = scale
        self._begun_s: float | None = None  # of the picture under way
        self._forgiven_s = 0.0

    def begin_picture(self, now_s: float) -> None:
        self._begun_s = now_s

    def end_picture(self, now_s: float) -> None:
        self._forgiven_s += self._beyond_s(now_s)
        self._begun_s = None

    def own_s(self, now_s: float) -> float:
        return (now_s - self._forgiven_s - self._beyond_s(now_s)) / self._scale

    def _beyond_s(self, now_s: float) -> float:
        """How much longer than it counts the picture under way takes."""
        return 0.0 if self._begun_s is None else max(0.0, now_s - self._begun_s - PICTURE_S * self._scale)
