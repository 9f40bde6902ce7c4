"""The time by which looks are limited, and what their pictures take of it. Pure: the time of our clock is an argument.

A picture of a simulated camera is drawn by this machine, which takes a third of a second when it is idle and half a
minute when it is busy. A limit of a look guards against a camera that gives nothing, so a picture under way counts as
long as it takes on an idle machine, and no longer. One that never comes is ended by who makes it.
"""

from __future__ import annotations

from collections import deque
from statistics import median

from rtc.protocol.messages import PictureTime

PICTURE_S = 1.0  # most that one picture counts
TIMES_KEPT = 3  # of a camera: one picture beside other work does not count alone


class LookClock:
    """`scale`: our seconds per second of the simulation, in which limits are stated."""

    def __init__(self, scale: float = 1.0) -> None:
        self._scale = scale
        self._begun_s: float | None = None  # of the picture under way
        self._forgiven_s = 0.0
        # Camera -> times of its latest whole pictures, and of one window in each of those of which windows were taken.
        self._whole_s: dict[str, deque[float]] = {}
        self._window_s: dict[str, deque[float]] = {}

    def begin_picture(self, now_s: float) -> None:
        self._begun_s = now_s

    def end_picture(self, now_s: float) -> None:
        self._forgiven_s += self._beyond_s(now_s)
        self._begun_s = None

    def note(self, camera: str, took_s: float, windows: int = 0) -> None:
        """A picture of a camera, or this number of windows of one, took so long by our clock, from its exposure until
        it was evaluated."""
        times = self._window_s if windows else self._whole_s
        own_s = min(PICTURE_S, took_s / self._scale) / max(1, windows)
        times.setdefault(camera, deque(maxlen=TIMES_KEPT)).append(own_s)

    def pictures(self) -> dict[str, PictureTime]:
        """What pictures take, of each camera that has given a whole one."""
        one = self._window_s
        return {
            name: PictureTime(whole_s=median(times), window_s=median(one[name]) if name in one else None)
            for name, times in self._whole_s.items()
        }

    def own_s(self, now_s: float) -> float:
        return (now_s - self._forgiven_s - self._beyond_s(now_s)) / self._scale

    def _beyond_s(self, now_s: float) -> float:
        """How much longer than it counts the picture under way takes."""
        return 0.0 if self._begun_s is None else max(0.0, now_s - self._begun_s - PICTURE_S * self._scale)
