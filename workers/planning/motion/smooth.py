"""Smooth rows of numbers through given ones: a cubic in each piece, with a common slope at every inner one. Pure.

The slope at a row comes from it and its two neighbours (Catmull-Rom, for uneven distances). So a row affects its
neighbouring pieces only, and the path hardly overshoots.
"""

from __future__ import annotations

import numpy as np

from rtc.spatial.geometry import Array

PER_PIECE = 10  # rows made for each piece


def through(s: Array, rows: Array, per_piece: int = PER_PIECE) -> tuple[Array, Array]:
    """(s, rows) with `per_piece` rows for each piece; the given ones [n][columns] are among them. `s` rises."""
    slopes = _slopes(s, rows)
    u = np.arange(per_piece) / per_piece
    dense_s, dense = [], []
    for k in range(len(s) - 1):
        width = s[k + 1] - s[k]
        h00, h10 = 2 * u**3 - 3 * u**2 + 1, u**3 - 2 * u**2 + u
        h01, h11 = 3 * u**2 - 2 * u**3, u**3 - u**2
        dense_s.append(s[k] + u * width)
        ends = np.outer(h00, rows[k]) + np.outer(h01, rows[k + 1])
        dense.append(ends + width * (np.outer(h10, slopes[k]) + np.outer(h11, slopes[k + 1])))
    return np.append(np.concatenate(dense_s), s[-1]), np.vstack((*dense, rows[-1]))


def _slopes(s: Array, rows: Array) -> Array:
    width = np.diff(s)[:, None]
    secants = np.diff(rows, axis=0) / width
    slopes = np.empty(rows.shape)
    slopes[1:-1] = (secants[:-1] * width[1:] + secants[1:] * width[:-1]) / (width[1:] + width[:-1])
    slopes[0] = 1.5 * secants[0] - 0.5 * slopes[1]
    slopes[-1] = 1.5 * secants[-1] - 0.5 * slopes[-2]
    return slopes
