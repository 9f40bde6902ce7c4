"""A path of straight lines in joint space whose corners are rounded off. Pure.

The parameter s is the length along the lines in the maximum norm. Within its radius of a corner the direction turns
from that of one line to that of the next by a smooth step. So position, direction and curvature are continuous. The
rounded corner lies within the triangle of the two lines.
"""

from __future__ import annotations

import numpy as np

from rtc.spatial.geometry import Array

MIN_LENGTH = 1e-9  # minimum length of a line


class Blended:
    """`blended(s, n)`: the n-th derivative (0, 1 or 2) by s at each of `s`, [len(s)][joints]."""

    def __init__(self, s: Array, corners: Array, radii: Array) -> None:
        """`s` of each corner rises; `radii` of the inner corners in the same unit. Neighbours must not overlap."""
        assert len(s) == len(corners) == len(radii) + 2 > 2, (len(s), len(corners), len(radii))
        self._s, self._corners, self.radii = s, corners, radii
        self._slopes = np.diff(corners, axis=0) / np.diff(s)[:, None]
        # Of two neighbouring corners the nearer one decides, measured from the ends of their radii.
        inner = s[1:-1]
        self._borders = 0.5 * (inner[:-1] + radii[:-1] + inner[1:] - radii[1:])

    @property
    def dof(self) -> int:
        """Number of joints. toppra reads this and `path_interval`."""
        return int(self._corners.shape[1])

    @property
    def path_interval(self) -> Array:
        return self._s[[0, -1]]

    @property
    def edges(self) -> Array:
        """s at which the corners begin and end."""
        return np.sort(np.concatenate((self._s[1:-1] - self.radii, self._s[1:-1] + self.radii)))

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        """The values and their first and second derivative by s, each [len(s)][joints]."""
        nearest = np.searchsorted(self._borders, s)
        radius = np.maximum(self.radii[nearest], MIN_LENGTH)[:, None]
        before, after = self._slopes[nearest], self._slopes[nearest + 1]
        past = (s - self._s[1:-1][nearest])[:, None]  # the corner
        u = np.clip((past + radius) / (2 * radius), 0.0, 1.0)
        turned = u * u * (3 - 2 * u)  # share of the second direction
        along = np.where(np.abs(past) < radius, 2 * radius * (u**3 - 0.5 * u**4), np.maximum(past, 0.0))
        values = self._corners[1:-1][nearest] + past * before + along * (after - before)
        bend = np.where(np.abs(past) < radius, 3 * u * (1 - u) / radius, 0.0) * (after - before)
        return values, before + turned * (after - before), bend

    def off_chords(self, s: Array) -> Array:
        """As `Path.off_chords`: the smallest of three bounds.

        Let L be the length of a chord, d the change of direction on it, r the radius of the corner. On a corner the
        direction turns one way only. So the curve is off its chord by at most d L / 4, and by at most L^2 / 8 times
        its second derivative. The corner itself is off its lines by 3/16 d r."""
        radii = np.maximum(self.radii, MIN_LENGTH)
        u = np.clip((s[:, None] - self._s[1:-1] + radii) / (2 * radii), 0.0, 1.0)
        turned = np.abs(np.diff(u * u * (3 - 2 * u), axis=0))
        most = np.where(turned > 0.0, 3 / 16 * radii, 0.0)
        middle = np.clip(0.5, u[:-1], u[1:])  # where it bends most
        width = np.diff(s)[:, None]
        off = np.minimum(0.25 * width * turned, 3 / 8 * width**2 * middle * (1 - middle) / radii)
        found: Array = np.minimum(off, most) @ np.abs(np.diff(self._slopes, axis=0))
        return found

    def __call__(self, s: Array, order: int = 0) -> Array:
        found = self.at(np.atleast_1d(s))[order]
        return found if np.ndim(s) else found[0]


def lengths(corners: Array) -> Array:
    """s of each corner: the length along the lines."""
    steps = np.maximum(np.abs(np.diff(corners, axis=0)).max(axis=1), MIN_LENGTH)
    return np.concatenate(((0.0,), np.cumsum(steps)))


def widest(s: Array) -> Array:
    """The largest radii of the inner corners: half of the shorter line beside each."""
    steps = np.diff(s)
    return 0.5 * np.minimum(steps[:-1], steps[1:])
