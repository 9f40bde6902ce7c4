"""A cubic spline through a table of joint values, with the not-a-knot condition at both ends. Pure.

It equals `toppra.SplineInterpolator` of the same table. It is cheaper to make for few knots, and a line of the hand is
made for each way that is tried.
"""

from __future__ import annotations

import numpy as np

from rtc.robot.geometry import Array


class Spline:
    """`spline(s, n)`: the n-th derivative (0, 1 or 2) by s at each of `s`, [len(s)][joints]."""

    def __init__(self, s: Array, rows: Array) -> None:
        """`s` rises; at least four rows."""
        assert len(s) == len(rows) >= 4, (len(s), len(rows))
        self._s = s
        width = np.diff(s)
        slope = np.diff(rows, axis=0) / width[:, None]
        speeds = _speeds(width, slope)
        # Of each piece, by powers of the distance from its beginning.
        bend = (speeds[:-1] + speeds[1:] - 2 * slope) / width[:, None]
        self._powers = np.stack((rows[:-1], speeds[:-1], (slope - speeds[:-1]) / width[:, None] - bend, bend))
        self._powers[3] /= width[:, None]

    def __call__(self, s: Array, order: int = 0) -> Array:
        piece = np.clip(np.searchsorted(self._s, s, side="right") - 1, 0, len(self._s) - 2)
        t = (s - self._s[piece])[:, None]
        a, b, c, d = self._powers[:, piece]
        found: Array
        if order == 0:
            found = a + t * (b + t * (c + t * d))
        elif order == 1:
            found = b + t * (2 * c + t * 3 * d)
        else:
            found = 2 * c + t * 6 * d
        return found


def _speeds(width: Array, slope: Array) -> Array:
    """The first derivative at each knot, [knots][joints]: the second one is continuous at every inner knot, and the
    third one at the knots next to the ends."""
    count = len(width) + 1
    matrix = np.zeros((count, count))
    wanted = np.empty((count, slope.shape[1]))
    inner = np.arange(1, count - 1)
    matrix[inner, inner - 1] = width[1:]
    matrix[inner, inner] = 2 * (width[:-1] + width[1:])
    matrix[inner, inner + 1] = width[:-1]
    wanted[1:-1] = 3 * (width[1:, None] * slope[:-1] + width[:-1, None] * slope[1:])
    both = width[0] + width[1]
    matrix[0, 0], matrix[0, 1] = width[1], both
    wanted[0] = ((width[0] + 2 * both) * width[1] * slope[0] + width[0] ** 2 * slope[1]) / both
    both = width[-1] + width[-2]
    matrix[-1, -1], matrix[-1, -2] = width[-2], both
    wanted[-1] = (width[-1] ** 2 * slope[-2] + (2 * both + width[-1]) * width[-2] * slope[-1]) / both
    solved: Array = np.asarray(np.linalg.solve(matrix, wanted), dtype=float)
    return solved
