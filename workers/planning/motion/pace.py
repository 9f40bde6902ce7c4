"""The time-optimal pace along a curve within joint accelerations, by a pass backwards and a pass forwards. Pure.

The pace is ds/dt at points of a grid; between two of them its square x changes evenly (the change of pace is constant).
At both ends of an interval every joint limits the same two unknowns, the squares at its ends:

    |alpha x + beta y| <= 1,    alpha and beta from slope and bend of the curve there

It is the discretisation of toppra ("interpolation"), and the result is the same: backwards the greatest x from which
the end can be reached, forwards the greatest y within that. Each of the two small linear programs has a closed form.
"""

from __future__ import annotations

import numpy as np

from rtc.model.robot import boxes
from rtc.spatial.geometry import Array

NONE = 1e-9  # share of the other coefficient below which a limit does not depend on an unknown
STEPS = 20  # of the search for the peak of an interval; 2 to 6 are usual
SAME = 1e-9  # relative tolerance of a peak


def fastest(grid: Array, slope: Array, bend: Array, most: Array, acceleration: Array) -> Array:
    """The greatest pace at each point of the grid (1/s), at rest at both ends.

    `slope`, `bend`: first and second derivative of the joints by s, [grid][joints]. `most`: the greatest pace there,
    [grid]. `acceleration`: of the joints (rad/s^2).
    """
    alpha, beta = _limits(grid, slope, bend, acceleration)
    found = _two_passes if boxes.squared_pace is None else boxes.squared_pace
    return np.sqrt(found(alpha, beta, _peaks(alpha, beta), most * most, NONE))


def _two_passes(alpha: Array, beta: Array, of_peaks: Array, of_squares: Array, none: float) -> list[float]:
    """The squared pace at each point of the grid. `of_squares`: the greatest one there by the other limits."""
    peaks, squares = of_peaks.tolist(), of_squares.tolist()
    reaches = [0.0]  # from the last point to the first
    for n, lines in zip(range(len(peaks) - 1, -1, -1), reversed(_lines(alpha, beta, none)), strict=True):
        y = min(reaches[-1], peaks[n])
        reaches.append(min(squares[n], min([most + rise * y for most, rise in lines])))
    found = [0.0]
    for reach, lines in zip(reaches[-2::-1], _lines(beta, alpha, none), strict=True):
        x = found[-1]
        found.append(max(0.0, min(reach, min([most + rise * x for most, rise in lines]))))
    return found


def _limits(grid: Array, slope: Array, bend: Array, acceleration: Array) -> tuple[Array, Array]:
    """alpha and beta of each interval, [intervals][2 joints]: of the joints at its beginning, and at its end."""
    twice = 2 * np.diff(grid)[:, None]
    begin, end = slope[:-1] / (twice * acceleration), slope[1:] / (twice * acceleration)
    bend = bend / acceleration
    return np.hstack((bend[:-1] - begin, -end)), np.hstack((begin, bend[1:] + end))


def _lines(own: Array, other: Array, none: float) -> list[list[tuple[float, float]]]:
    """The greatest value of one unknown by the other, as lines (value at 0, rise) of each interval."""
    free = np.abs(own) <= none * np.abs(other)
    own = np.where(free, 1.0, own)
    most, rise = np.where(free, np.inf, np.abs(1 / own)), np.where(free, 0.0, -other / own)
    return [list(zip(*pair, strict=True)) for pair in zip(most.tolist(), rise.tolist(), strict=True)]


def _peaks(alpha: Array, beta: Array) -> Array:
    """The y at the greatest x that the limits of each interval allow; at least 0.

    With y = r x that x is the reciprocal of the greatest |alpha + beta r|, which is convex in r: its least value is
    where a line that falls meets one that rises. The two are replaced by what is greater there until nothing is.
    """
    sign = np.where(beta < 0, -1.0, 1.0)
    alpha, beta, rows = alpha * sign, beta * sign, np.arange(len(alpha))
    falls = rises = beta.argmax(axis=1)
    for _ in range(STEPS):
        width = beta[rows, falls] + beta[rows, rises]
        r = -(alpha[rows, falls] + alpha[rows, rises]) / np.where(width > 0, width, 1.0)
        values = alpha + beta * r[:, None]
        greatest = np.abs(values).argmax(axis=1)
        value = values[rows, greatest]
        if (np.abs(value) <= (1 + SAME) * (alpha[rows, rises] + beta[rows, rises] * r) + NONE).all():
            break
        falls, rises = np.where(value > 0, falls, greatest), np.where(value > 0, greatest, rises)
    peaks: Array = np.maximum(r, 0.0) / np.maximum(np.abs(value), NONE)
    return peaks
