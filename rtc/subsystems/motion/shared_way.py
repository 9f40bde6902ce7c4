"""The program's part of a motion that it shares with the operator: a path, in the other axes. Pure.

Its time goes on while the deadman is held. It waits for an arm that lags behind: the joints are slower than the path
asks, or the operator's twist takes their speed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from rtc.protocol.primitive import JointTrajectory
from rtc.protocol.units import measured_in_words
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import TICK_S
from rtc.subsystems.motion.profiles import Follow

GAIN_PER_S = 4.0  # of what the tcp is off the path
LAG_M, LAG_RAD = 0.01, 0.05  # so far behind, the path waits
WAITS = 0.9  # share of these lags from which on the path is reported to wait
ENDS = 0.2  # the same at its end, where nothing else brings the arm nearer
RATE_PER_S = 2.0  # change of the rate of its time
REFRESH_TICKS = 5  # the program's twist follows path and arm at this interval, the operator's twist each tick
REFRESH_S = REFRESH_TICKS * TICK_S


class SharedWay:
    def __init__(
        self, along: JointTrajectory, operator_axes: Sequence[int], pose_of: Callable[[Sequence[float]], Array]
    ) -> None:
        self._path, self._pose_of = Follow(along, along.positions[0]), pose_of
        self._operator_axes: Array = np.isin(np.arange(6), operator_axes).astype(float).reshape(2, 3)
        self._end = pose_of(along.positions[-1])
        self._time_s = self._rate = 0.0
        self._pose = self._pose_at(0.0)
        self._ticks = 0
        self.waits_for = ""  # where the arm is, and which way in the operator's axes, while the path waits for it
        self.towards: list[float] = []  # that way: m and rad, world axes; empty: the path does not wait
        self._own: Array = np.zeros(6)  # the twist of the program
        self._to_operator: Array = np.zeros((6, 6))  # a twist -> its part in the operator's axes, both in world axes

    def off(self, tcp: Array) -> tuple[float, float]:
        """How far the tcp is off the end of the path in the axes of the program (m, rad)."""
        return _sizes(_in_axes(_axes(tcp), _between(tcp, self._end), 1.0 - self._operator_axes))

    def wait(self) -> None:
        """The deadman is let go: the path begins slowly when it is held again."""
        self._rate, self._ticks = 0.0, 0

    def twist(self, tcp: Array, wanted: Sequence[float]) -> list[float]:
        """One tick further: the twist of the tcp, with what the operator wants. Both m/s, rad/s, world axes."""
        if self._ticks % REFRESH_TICKS == 0:
            self._go_on(tcp)
        self._ticks += 1
        both: list[float] = (self._own + self._to_operator @ wanted).tolist()
        return both

    def _go_on(self, tcp: Array) -> None:
        """The program's twist for the next REFRESH_TICKS."""
        axes = _axes(tcp)
        behind = _in_axes(axes, _between(tcp, self._pose), 1.0 - self._operator_axes)
        lag_m, lag_rad = _sizes(behind)
        lag = max(lag_m / LAG_M, lag_rad / LAG_RAD)
        self.waits_for, self.towards = "", []
        if lag > (ENDS if self._time_s >= self._path.duration_s else WAITS):
            aside = _in_axes(axes, _between(tcp, self._pose), self._operator_axes)
            self.waits_for = f"{_in_words(lag_m, lag_rad)} behind it{_which_way(axes, aside)}"
            self.towards = aside.tolist()
        self._rate = min(self._rate + RATE_PER_S * REFRESH_S, max(0.0, 1.0 - lag))
        self._time_s = min(self._time_s + self._rate * REFRESH_S, self._path.duration_s)
        before, self._pose = self._pose, self._pose_at(self._time_s)
        ahead = _in_axes(axes, _between(before, self._pose) / REFRESH_S, 1.0 - self._operator_axes)
        self._own = ahead + GAIN_PER_S * behind
        for part, which in enumerate(self._operator_axes):
            block = slice(3 * part, 3 * part + 3)
            self._to_operator[block, block] = (axes * which) @ axes.T

    def _pose_at(self, time_s: float) -> Array:
        return self._pose_of(self._path.path(np.array([time_s]))[0, 0].tolist())


def _between(a: Array, b: Array) -> Array:
    """From one pose to another: m, rad, world axes."""
    return np.concatenate((b[:3] - a[:3], geometry.rotation_vector(a, b)))


def _axes(tcp: Array) -> Array:
    axes: Array = geometry.to_matrix(tcp)[:3, :3]
    return axes


def _in_axes(axes: Array, twist: Array, which: Array) -> Array:
    """The part of a twist (world axes) along and about these axes of the tool (2 x 3 of 0 or 1)."""
    part: Array = ((twist.reshape(2, 3) @ axes) * which) @ axes.T
    return part.ravel()


def _which_way(axes: Array, aside: Array) -> str:
    """What the operator does to come to the path, in the axes of the tool; empty: it is there."""
    parts, units = aside.reshape(2, 3) @ axes, (("move", "along", "m"), ("turn", "about", "rad"))
    found = []
    for part, least, (verb, where, unit) in zip(parts, (LAG_M, LAG_RAD), units, strict=True):
        n = int(np.abs(part).argmax())
        if abs(part[n]) > least:
            axis = f"{'-' if part[n] < 0.0 else ''}TOOL-{'XYZ'[n]}"
            found.append(f"{verb} {where} {axis} by {measured_in_words(abs(part[n]), unit)}")
    return f": {', '.join(found)}" if found else ""


def _in_words(m: float, rad: float) -> str:
    return f"{measured_in_words(m, 'm')} and {measured_in_words(rad, 'rad')}"


def _sizes(twist: Array) -> tuple[float, float]:
    return float(np.linalg.norm(twist[:3])), float(np.linalg.norm(twist[3:]))
