"""Poses: every operation against its matrix, over seeded random poses."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from rtc.spatial import geometry as g

RANDOM = np.random.default_rng(11)
POSES = [g.make_pose(RANDOM.uniform(-2, 2, 3), RANDOM.normal(size=4)) for _ in range(50)]
PAIRS = list(itertools.pairwise(POSES))


@pytest.mark.parametrize(("a", "b"), PAIRS[:20])
def test_compose_is_the_product_of_the_matrices(a, b):
    assert np.allclose(g.to_matrix(g.compose(a, b)), g.to_matrix(a) @ g.to_matrix(b), atol=1e-14)


@pytest.mark.parametrize("a", POSES)
def test_inverse_matrix_and_rpy_come_back(a):
    assert np.allclose(g.to_matrix(g.inverse(a)), np.linalg.inv(g.to_matrix(a)), atol=1e-13)
    assert np.allclose(g.from_matrix(g.to_matrix(a)), a, atol=1e-14)
    assert np.allclose(g.from_rpy(a[:3], g.to_rpy(a)), a, atol=1e-12)


@pytest.mark.parametrize("pitch", [-math.pi / 2, math.pi / 2])
@pytest.mark.parametrize("roll", [-2.0, 0.0, 0.7])
def test_rpy_comes_back_at_the_pole(pitch, roll):
    pose = g.from_rpy((1, 2, 3), (roll, pitch, 0.4))
    assert g.angle(g.from_rpy((1, 2, 3), g.to_rpy(pose)), pose) < 1e-7


@pytest.mark.parametrize(("a", "b"), PAIRS[:20])
def test_relative_undoes_compose_and_points_follow(a, b):
    assert np.allclose(g.normalise(g.compose(a, g.relative(a, b))), b, atol=1e-13)
    point = (0.1, -0.2, 0.3)
    assert np.allclose(g.transform_point(a, point), (g.to_matrix(a) @ (*point, 1))[:3])
    assert np.allclose(g.rotate(a, point), g.to_matrix(a)[:3, :3] @ point)


@pytest.mark.parametrize(("a", "b"), PAIRS[:20])
def test_interpolation_runs_evenly_from_end_to_end(a, b):
    first, third, last = g.interpolate_all(a, b, np.array([0.0, 1 / 3, 1.0]))
    assert np.allclose(first, a)
    assert g.angle(last, b) < 1e-7
    assert g.angle(a, third) == pytest.approx(g.angle(a, b) / 3, abs=1e-9)
    assert g.distance(a, third) == pytest.approx(g.distance(a, b) / 3)
    assert np.linalg.norm(g.rotation_vector(a, b)) == pytest.approx(g.angle(a, b))


def test_level_straddles_a_vertical_bar():
    level = g.make_pose((0, 0, 0), g.LEVEL)
    assert np.allclose(g.rotate(level, (0, 0, 1)), (1, 0, 0), atol=1e-15)  # approaches along world +x
    assert np.allclose(g.rotate(level, (0, 1, 0)), (0, 1, 0), atol=1e-15)  # closes horizontally
    assert np.allclose(g.rotate(level, (1, 0, 0)), (0, 0, -1), atol=1e-15)


def test_a_quaternion_of_zero_length_is_an_error():
    with pytest.raises(ValueError, match="length zero"):
        g.make_pose((0, 0, 0), (0, 0, 0, 0))
