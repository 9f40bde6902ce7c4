"""Quintic Hermite trajectories between their knots: values and bounds of position, velocity, acceleration. Pure.

A polynomial lies between the least and the greatest of its Bernstein control points. Subdivision moves the control
points towards the curve. After a few halvings all points of a piece are inside the limits, or an end is outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rtc.spatial.geometry import Array, Floats

HALVINGS = 20  # maximum number of subdivisions, to a millionth of the length
MAX_OPEN = 20_000  # maximum number of undecided pieces; beyond it the trajectory counts as outside


# Powers and factors of u in the value, the first and the second derivative of 1, u .. u^5.
DERIVATIVE_POWERS = np.array([0, 1, 2, 3, 4, 5, 0, 0, 1, 2, 3, 4, 0, 0, 0, 1, 2, 3])
DERIVATIVE_FACTORS = np.array([1, 1, 1, 1, 1, 1, 0, 1, 2, 3, 4, 5, 0, 0, 2, 6, 12, 20], dtype=np.float64)


class Hermite:
    """The quintic polynomials through position, velocity and acceleration of the knots, each [knots][joints]."""

    def __init__(
        self, time_s: Sequence[float] | Array, positions: object, velocities: object, accelerations: object
    ) -> None:
        q, v, a = (np.asarray(rows, dtype=float) for rows in (positions, velocities, accelerations))
        self._knots_s = np.asarray(time_s, dtype=float)
        # All pieces at once: one by one, the start of a long path would make the ticks of other arms late.
        t = np.diff(self._knots_s)[:, None]
        dq = np.diff(q, axis=0) - v[:-1] * t - 0.5 * a[:-1] * t * t
        dv = np.diff(v, axis=0) - a[:-1] * t
        da = np.diff(a, axis=0)
        self._pieces = np.stack(  # [pieces][power of the time since the knot][joints]
            (
                q[:-1],
                v[:-1],
                0.5 * a[:-1],
                (10 * dq - 4 * dv * t + 0.5 * da * t * t) / t**3,
                (-15 * dq + 7 * dv * t - da * t * t) / t**4,
                (6 * dq - 3 * dv * t + 0.5 * da * t * t) / t**5,
            ),
            axis=1,
        )

    def at(self, times_s: Array) -> Array:
        """[times][3][joints]: positions, velocities, accelerations; before and after the knots those of the ends."""
        t = np.clip(times_s, 0.0, self._knots_s[-1])
        piece = np.searchsorted(self._knots_s[1:-1], t, side="right")
        powers = np.empty((len(t), 6))  # of the time since the knot: 1, u .. u^5
        powers[:, 0] = 1.0
        powers[:, 1:] = (t - self._knots_s[piece])[:, None]
        np.multiply.accumulate(powers, axis=1, out=powers)
        basis = (powers[:, DERIVATIVE_POWERS] * DERIVATIVE_FACTORS).reshape(-1, 3, 6)
        coefficients = self._pieces[piece[0]] if piece[0] == piece[-1] else self._pieces[piece]  # the first is quicker
        motions: Array = basis @ coefficients
        return motions


def fine_times(time_s: Sequence[float] | Array, step_s: float) -> Array:
    """The times of the knots, and even ones between those that are more than `step_s` apart."""
    knots_s = np.asarray(time_s, dtype=float)
    pieces = np.maximum(1, np.ceil(np.diff(knots_s) / step_s - 1e-9)).astype(int)
    index = np.append(0, np.cumsum(pieces))
    times_s: Array = np.interp(np.arange(index[-1] + 1), index, knots_s)
    return times_s


class ControlPoints(NamedTuple):
    """Bernstein control points of every piece, each [pieces][points][joints]: rad, rad/s, rad/s^2."""

    positions: Array
    velocities: Array
    accelerations: Array


class Excess(NamedTuple):
    """A violation of the limits by a trajectory."""

    piece: int  # index of the knot before it
    joint: int
    value: float


def control_points(
    time_s: Sequence[float] | Array, positions: object, velocities: object, accelerations: object
) -> ControlPoints:
    """Control points of the quintic Hermite polynomials between knots. [knots][joints], rad, rad/s, rad/s^2."""
    q, v, a = (np.asarray(rows, dtype=float) for rows in (positions, velocities, accelerations))
    knots_s = np.asarray(time_s, dtype=float)
    t = (knots_s[1:] - knots_s[:-1])[:, None]
    points = np.empty((len(t), 6, q.shape[1]))
    with np.errstate(all="ignore"):  # values near 1e300 give inf or nan, which count as outside
        fifth, twentieth = 0.2 * t, 0.05 * t * t
        points[:, 0], points[:, 5] = q[:-1], q[1:]
        points[:, 1], points[:, 4] = q[:-1] + fifth * v[:-1], q[1:] - fifth * v[1:]
        points[:, 2] = points[:, 1] + fifth * v[:-1] + twentieth * a[:-1]
        points[:, 3] = points[:, 4] - fifth * v[1:] + twentieth * a[1:]
        per_s = 1.0 / t[:, None]
        speeds = (points[:, 1:] - points[:, :-1]) * (5.0 * per_s)
        changes = (speeds[:, 1:] - speeds[:, :-1]) * (4.0 * per_s)
        # The ends are set exactly; differences of positions would round them.
        speeds[:, 0], speeds[:, -1] = v[:-1], v[1:]
        changes[:, 0], changes[:, -1] = a[:-1], a[1:]
    return ControlPoints(points, speeds, changes)


def excess(points: Array, low: Floats, high: Floats) -> Excess | None:
    """The first violation found of [low, high] (one value per joint) in these pieces; None: all are inside."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    piece, joint = np.nonzero(~((points >= low) & (points <= high)).all(axis=1))  # nan is outside
    if not piece.size:
        return None
    rows = points[piece, :, joint]
    with np.errstate(all="ignore"):
        for _ in range(HALVINGS):
            ends = rows[:, [0, -1]]
            found = np.flatnonzero(~((ends >= low[joint, None]) & (ends <= high[joint, None])).all(axis=1))
            if found.size or len(rows) > MAX_OPEN:
                break
            rows, piece, joint = _halves(rows), np.repeat(piece, 2), np.repeat(joint, 2)
            still = ~((rows >= low[joint, None]) & (rows <= high[joint, None])).all(axis=1)
            rows, piece, joint = rows[still], piece[still], joint[still]
            if not piece.size:
                return None
    n = int(found[0]) if found.size else 0
    k, candidates = int(joint[n]), ends[n] if found.size else rows[n]
    beyond = [value for value in candidates.tolist() if not low[k] <= value <= high[k]]
    return Excess(int(piece[n]), k, max(beyond, key=abs))


def most_beyond(points: Array, limits: Floats, halvings: int = 4) -> float:
    """An upper bound of the magnitude over all pieces and joints, relative to each joint's limit; 1 if all are within.

    It is too great by at most about 0.1 %."""
    if bool((np.abs(points).max(axis=(0, 1)) <= limits).all()):
        return 1.0  # usually
    rows = (points / np.asarray(limits, dtype=float)).transpose(0, 2, 1).reshape(-1, points.shape[1])
    for _ in range(halvings):
        rows = rows[np.abs(rows).max(axis=1) > 1.0]  # the other pieces are within the limits
        if not len(rows):
            return 1.0
        rows = _halves(rows)
    return max(1.0, float(np.abs(rows).max()))


def _halves(rows: Array) -> Array:
    """Subdivision by de Casteljau: the control points of the two halves of each row, in order."""
    lefts, rights, now = [rows[:, 0]], [rows[:, -1]], rows
    while now.shape[1] > 1:
        now = 0.5 * (now[:, 1:] + now[:, :-1])
        lefts.append(now[:, 0])
        rights.append(now[:, -1])
    both = np.stack((np.stack(lefts, axis=1), np.stack(rights[::-1], axis=1)), axis=1)
    return both.reshape(-1, rows.shape[1])
