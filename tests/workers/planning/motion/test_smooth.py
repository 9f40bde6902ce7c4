"""Smooth curves through given rows, and those of the tcp and of the joints made from them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from rtc.spatial import geometry
from workers.planning.motion import smooth
from workers.planning.motion.path import poses_through, spline_through
from workers.planning.motion.timing import SpeedLimits, time_path

S = np.array([0.0, 1.0, 3.0, 3.5])
ROWS = np.array([[0.0, 1.0], [1.0, 1.0], [0.0, 4.0], [0.5, 4.0]])


def test_the_given_rows_are_among_the_smooth_ones_and_the_slope_is_continuous() -> None:
    s, rows = smooth.through(S, ROWS, 200)
    for at, row in zip(S, ROWS, strict=True):
        assert rows[int(np.abs(s - at).argmin())] == pytest.approx(row)
    slopes = np.diff(rows, axis=0) / np.diff(s)[:, None]
    assert np.abs(np.diff(slopes, axis=0)).max() < 0.1
    assert rows.min() > -0.3
    assert rows.max() < 4.4


def test_rows_on_a_line_stay_on_it() -> None:
    line = np.outer(S, [1.0, -2.0])
    s, rows = smooth.through(S, line)
    assert rows == pytest.approx(np.outer(s, [1.0, -2.0]))


def test_a_curve_of_the_tcp_passes_through_its_poses_with_their_attitudes() -> None:
    poses = [
        geometry.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        geometry.from_rpy((0.3, 0.0, 0.1), (0.0, 0.0, 2.0)),
        geometry.from_rpy((0.3, 0.4, 0.1), (0.0, 0.0, 3.5)),
    ]
    table = poses_through(poses)
    for pose in poses:
        assert min(geometry.distance(row, pose) + geometry.angle(row, pose) for row in table) < 1e-6
    assert np.linalg.norm(table[:, 3:], axis=1) == pytest.approx(1.0)
    turned = [geometry.angle(a, b) for a, b in pairwise(table)]
    assert max(turned) < 0.3


def test_a_spline_through_postures_is_timed_within_the_limits_and_does_not_stop(right, home) -> None:
    start = np.array(home["RIGHT-ARM"])
    via, goal = start + np.array((0.3, 0.1, 0, 0.2, 0, 0)), start + np.array((0.6, 0, 0.1, 0, 0, 0.3))
    way = spline_through([start, via, goal])
    timed = time_path(right, way, SpeedLimits(0.25, 1.0))
    nearest = int(np.abs(timed.positions - via).max(axis=1).argmin())
    assert np.abs(timed.positions[nearest] - via).max() < 0.02
    assert np.abs(timed.velocities[nearest]).max() > 0.05
    assert (np.abs(timed.velocities) <= right.limits.velocity).all()
    assert right.tcp_speeds(timed.positions, timed.velocities).max() < 0.26
