"""A cubic spline through a table of values, with the not-a-knot condition at both ends, or at rest there. Pure.

It equals `toppra.SplineInterpolator` of the same table. It is cheaper to make for few knots, and a line of the hand is
made for each way that is tried.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from rtc.spatial.geometry import Array

EVEN = 1e-9  # relative tolerance of the distances between evenly spaced knots


class Spline:
    """`spline(s, n)`: the n-th derivative (0, 1 or 2) by s at each of `s`, [len(s)][joints]."""

    def __init__(self, s: Array, rows: Array, *, at_rest: bool = False) -> None:
        """`s` rises; at least four rows. `at_rest`: the first derivative is 0 at both ends."""
        assert len(s) == len(rows) >= 4, (len(s), len(rows))
        self._s = s
        width = s[1:] - s[:-1]
        slope = (rows[1:] - rows[:-1]) / width[:, None]
        speeds = _resting_speeds(width, slope) if at_rest else _speeds(width, slope)
        # Of each piece, by powers of the distance from its beginning.
        bend = (speeds[:-1] + speeds[1:] - 2 * slope) / width[:, None]
        self._powers = np.empty((4, *slope.shape))
        self._powers[0], self._powers[1] = rows[:-1], speeds[:-1]
        self._powers[2] = (slope - speeds[:-1]) / width[:, None] - bend
        self._powers[3] = bend / width[:, None]

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        """The values and their first and second derivative by s, each [len(s)][joints]."""
        t, (a, b, c, d) = self._piece(s)
        return a + t * (b + t * (c + t * d)), b + t * (2 * c + t * 3 * d), 2 * c + t * 6 * d

    def __call__(self, s: Array, order: int = 0) -> Array:
        t, (a, b, c, d) = self._piece(s)
        found: Array
        if order == 0:
            found = a + t * (b + t * (c + t * d))
        elif order == 1:
            found = b + t * (2 * c + t * 3 * d)
        else:
            found = 2 * c + t * 6 * d
        return found

    def off_chords(self, s: Array) -> Array:
        """As `Path.off_chords`. The second derivative of a piece is greatest at one of its ends."""
        bend = np.abs(self(s, 2))
        found: Array = np.maximum(bend[1:], bend[:-1]) * (np.diff(s) ** 2 / 8)[:, None]
        return found

    def _piece(self, s: Array) -> tuple[Array, Array]:
        """Of each s: the distance from the beginning of its piece, and the powers of that piece."""
        piece = np.searchsorted(self._s[1:-1], s, side="right")
        return (s - self._s[piece])[:, None], self._powers[:, piece]


def _speeds(width: Array, slope: Array) -> Array:
    """The first derivative at each knot, [knots][joints]. The second one is continuous at every inner knot, the third
    one at the knots next to the ends."""
    wanted = np.empty((len(width) + 1, slope.shape[1]))
    wanted[1:-1] = 3 * (width[1:, None] * slope[:-1] + width[:-1, None] * slope[1:])
    both = width[0] + width[1]
    wanted[0] = ((width[0] + 2 * both) * width[1] * slope[0] + width[0] ** 2 * slope[1]) / both
    both = width[-1] + width[-2]
    wanted[-1] = (width[-1] ** 2 * slope[-2] + (2 * both + width[-1]) * width[-2] * slope[-1]) / both
    if np.abs(width - width[0]).max() < EVEN * width[0]:
        speeds: Array = _inverse(len(width)) @ wanted / width[0]
    else:
        speeds = np.asarray(np.linalg.solve(_matrix(width), wanted), dtype=float)
    return speeds


def _resting_speeds(width: Array, slope: Array) -> Array:
    """As `_speeds`, with 0 at both ends instead of the condition on the third derivative."""
    wanted = 3 * (width[1:, None] * slope[:-1] + width[:-1, None] * slope[1:])
    speeds = np.zeros((len(width) + 1, slope.shape[1]))
    below, diagonal, above = width[2:].tolist(), (2 * (width[:-1] + width[1:])).tolist(), width[:-2].tolist()
    speeds[1:-1] = np.transpose([_solved(below, diagonal, above, column) for column in wanted.T.tolist()])
    return speeds


def _solved(below: list[float], diagonal: list[float], above: list[float], wanted: list[float]) -> list[float]:
    """The solution of a tridiagonal system whose diagonal is dominant. scipy has it, but takes 0.2 s to import."""
    diagonal, found = [*diagonal], [*wanted]
    for n, value in enumerate(below):
        share = value / diagonal[n]
        diagonal[n + 1] -= share * above[n]
        found[n + 1] -= share * found[n]
    found[-1] /= diagonal[-1]
    for n in range(len(above) - 1, -1, -1):
        found[n] = (found[n] - above[n] * found[n + 1]) / diagonal[n]
    return found


def _matrix(width: Array) -> Array:
    """The conditions on the speeds, [knots][knots]."""
    count = len(width) + 1
    matrix = np.zeros((count, count))
    inner = np.arange(1, count - 1)
    matrix[inner, inner - 1] = width[1:]
    matrix[inner, inner] = 2 * (width[:-1] + width[1:])
    matrix[inner, inner + 1] = width[:-1]
    matrix[0, 0], matrix[0, 1] = width[1], width[0] + width[1]
    matrix[-1, -1], matrix[-1, -2] = width[-2], width[-1] + width[-2]
    return matrix


@lru_cache(maxsize=128)
def _inverse(pieces: int) -> Array:
    """The inverse of the matrix of this number of pieces, each of length 1."""
    inverse: Array = np.asarray(np.linalg.inv(_matrix(np.ones(pieces))), dtype=float)
    return inverse
