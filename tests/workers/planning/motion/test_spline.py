"""The spline equals that of toppra."""

import numpy as np
import pytest

from workers.planning.motion.spline import Spline
from workers.planning.motion.within_torques import toppra


@pytest.mark.parametrize("evenly", [False, True])
@pytest.mark.parametrize("count", [4, 5, 9, 30])
def test_it_equals_the_spline_of_toppra(count, evenly):
    rng = np.random.default_rng(count)
    s = np.concatenate(((0.0,), np.cumsum(np.full(count - 1, 0.02) if evenly else rng.uniform(0.01, 0.03, count - 1))))
    rows = rng.normal(size=(count, 6))
    ours, theirs = Spline(s, rows), toppra.SplineInterpolator(s, rows)
    at = np.concatenate((s, np.linspace(0.0, s[-1], 101)))
    for order in range(3):
        wanted = theirs(at, order)
        assert np.abs(ours(at, order) - wanted).max() <= 1e-9 * np.abs(wanted).max()
        assert (ours.at(at)[order] == ours(at, order)).all()


def test_at_rest_it_equals_a_spline_with_these_ends():
    rng = np.random.default_rng(3)
    s, rows = np.cumsum(rng.uniform(0.01, 0.5, 40)), rng.normal(size=(40, 2))
    ours, theirs = Spline(s - s[0], rows, at_rest=True), toppra.SplineInterpolator(s - s[0], rows, "clamped")
    at = np.linspace(0.0, s[-1] - s[0], 301)
    for order in range(3):
        wanted = theirs(at, order)
        assert np.abs(ours(at, order) - wanted).max() <= 1e-9 * np.abs(wanted).max()
