"""A path with a piece without length: equal neighbours are one point, in every path that is made of points."""

from __future__ import annotations

import itertools
import time

import numpy as np
import pytest

from rtc.model.robot.kinematics import ArmModel
from rtc.spatial import geometry
from workers.planning.motion import path as paths
from workers.planning.motion.timing import time_path

NEAR_M = [0.0, 1e-9, 1e-6, 1e-5, 9e-5, 1.1e-4, 1e-3]


POSTURE = np.radians([0.0, 110.0, -160.0, 0.0, 50.0, 0.0])


def in_time(arm: ArmModel, path: paths.Path) -> float:
    """The duration of the path; its computation is short."""
    began_s = time.process_time()
    timed = time_path(arm, path)
    assert np.isfinite(timed.positions).all()
    assert np.isfinite(timed.accelerations).all()
    assert time.process_time() - began_s < 5.0
    return timed.duration_s


@pytest.mark.parametrize("near_m", NEAR_M)
@pytest.mark.parametrize("order", ["abbc", "aabc", "abcc", "aaaa", "aabbcc", "aa", "aba"])
def test_the_hand_through_equal_poses(right: ArmModel, order: str, near_m: float) -> None:
    """Each pose that stands for the same letter again is `near_m` beside the one before."""
    q = POSTURE
    at = right.fk(q)
    places = {"a": at, "b": geometry.translate(at, (0.05, 0.0, 0.0)), "c": geometry.translate(at, (0.08, 0.04, 0.0))}
    poses = [places[order[0]]]
    for before, letter in itertools.pairwise(order):
        again = geometry.translate(poses[-1], (0.0, 0.0, near_m))
        poses.append(again if before == letter else places[letter])
    path = paths.task_curve(right, q, paths.poses_through(poses))
    assert geometry.distance(right.fk(path.knots[-1]), poses[-1]) < 2e-4
    assert in_time(right, path) < 30.0


@pytest.mark.parametrize("near_rad", NEAR_M)
@pytest.mark.parametrize("order", ["abbc", "aabc", "abcc", "aaaa", "aabbcc", "aa", "aba"])
def test_joints_through_equal_postures(right: ArmModel, order: str, near_rad: float) -> None:
    q = POSTURE
    places = {"a": q, "b": q + 0.2, "c": q - 0.1}
    postures = [places[order[0]]]
    for before, letter in itertools.pairwise(order):
        postures.append(postures[-1] + near_rad if before == letter else places[letter])
    for path in (paths.spline_through(postures), paths.through(postures)):
        assert path.knots[0].tolist() == postures[0].tolist()
        assert path.knots[-1].tolist() == postures[-1].tolist()
        assert in_time(right, path) < 30.0
