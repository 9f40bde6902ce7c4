"""The pace along a curve: the same as toppra's, on the same grid and limits."""

from __future__ import annotations

import numpy as np
import pytest

from rtc.model.robot import boxes, compiled
from workers.planning.motion import timing, within_torques
from workers.planning.motion.blended import lengths, widest
from workers.planning.motion.pace import fastest
from workers.planning.motion.path import spline_through, through

SAME = 1e-5  # of the duration


def curves(arm, seed, count=30):
    """Rounded corners, wide and narrow, and splines, through seeded random postures."""
    random = np.random.default_rng(seed)
    low, high = 0.7 * arm.limits.lower, 0.7 * arm.limits.upper
    for n in range(count):
        postures = random.uniform(low, high, (3 + n % 4, 6))
        radii = widest(lengths(postures)) * random.uniform(0.05, 1.0)
        yield [through(list(postures)), through(list(postures), radii), spline_through(list(postures))][n % 3]


def limits(arm, path, random):
    """(grid, slope, bend, greatest pace, accelerations): the last two are random but for the speeds of the joints."""
    grid = timing._grid(path)
    _, slope, bend = path.at(grid)
    by_joints = (arm.limits.velocity / np.maximum(np.abs(slope), timing.STILL)).min(axis=1)
    most = np.minimum(by_joints, random.uniform(0.1, 2.0) * random.uniform(0.7, 1.0, len(grid)))
    return grid, slope, bend, most, arm.limits.acceleration * random.uniform(0.05, 1.0, 6)


def duration_s(grid, pace):
    return float((2 * np.diff(grid) / (pace[1:] + pace[:-1])).sum())


def by_toppra(path, grid, most, acceleration):
    toppra = within_torques.toppra
    whole = path.curve if hasattr(path.curve, "dof") else toppra.SplineInterpolator(path.s, path.knots)
    constraints = [within_torques._MostPace(most), within_torques._MostAccelerations(acceleration)]
    return toppra.algorithm.TOPPRA(constraints, whole, gridpoints=grid).compute_parameterization(0.0, 0.0)[1]


def test_it_is_as_fast_as_toppra(right):
    random = np.random.default_rng(1)
    for path in curves(right, seed=2):
        grid, slope, bend, most, acceleration = limits(right, path, random)
        ours, theirs = fastest(grid, slope, bend, most, acceleration), by_toppra(path, grid, most, acceleration)
        assert duration_s(grid, ours) == pytest.approx(duration_s(grid, theirs), rel=SAME)
        assert np.abs(ours - theirs).max() < 1e-3 * theirs.max()


def test_no_limit_is_passed_at_either_end_of_an_interval(right):
    random = np.random.default_rng(4)
    for path in curves(right, seed=5):
        grid, slope, bend, most, acceleration = limits(right, path, random)
        pace = fastest(grid, slope, bend, most, acceleration)
        assert pace[0] == pace[-1] == 0.0
        assert (pace <= most * (1 + 1e-9)).all()
        square = (pace**2)[:, None]
        change = np.diff(square, axis=0) / (2 * np.diff(grid)[:, None])
        for rows in (slice(None, -1), slice(1, None)):
            assert (np.abs(slope[rows] * change + bend[rows] * square[rows]) <= acceleration * (1 + 1e-6)).all()


def test_one_joint_that_turns_evenly_accelerates_and_brakes_with_all_it_has():
    grid = np.linspace(0.0, 2.0, 41)
    straight = np.stack((np.ones(41), np.zeros(41)), axis=1)
    pace = fastest(grid, straight, np.zeros((41, 2)), np.full(41, 9.0), np.array([3.0, 1.0]))
    assert np.allclose(pace**2, 2 * 3.0 * np.minimum(grid, 2.0 - grid))


@pytest.mark.skipif(not compiled(), reason="installed without a compiler")
def test_the_compiled_passes_are_those_in_python(right, monkeypatch):
    random = np.random.default_rng(7)
    for path in curves(right, seed=8):
        given = limits(right, path, random)
        ours = fastest(*given)
        with monkeypatch.context() as patch:
            patch.setattr(boxes, "squared_pace", None)
            assert np.array_equal(ours, fastest(*given))
