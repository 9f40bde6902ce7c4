"""Angles and poses about a hinge."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtc.spatial import geometry, hinges

HOME = geometry.from_rpy((0.75, 0.17, 0.70), (0.1, -0.2, 0.3))
AXES = [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.6, 0.0, 0.8)]
ANGLES = [-1.5, -0.1, 0.0, 0.4, 1.57, 3.0]


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("angle", ANGLES)
def test_the_angle_of_a_turned_pose_is_the_one_it_was_turned_by(axis, angle) -> None:
    assert hinges.angle_of(HOME, axis, hinges.turned(HOME, axis, angle)) == pytest.approx(angle)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("angle", ANGLES)
def test_a_point_of_the_body_tells_its_angle_from_any_distance(axis, angle) -> None:
    point = np.array((-0.1, -0.2, 0.05))
    where = geometry.transform_point(hinges.turned(HOME, axis, angle), 1.1 * point)
    assert hinges.angle_at(HOME, axis, point, where) == pytest.approx(angle, abs=0.06)
    exact = geometry.transform_point(hinges.turned(HOME, axis, angle), point)
    assert hinges.angle_at(HOME, axis, point, exact) == pytest.approx(angle)


@pytest.mark.parametrize("axis", AXES)
def test_the_frame_of_a_hinge_has_its_z_along_the_axis(axis) -> None:
    made = hinges.frame(HOME, axis)
    assert np.allclose(made[:3], HOME[:3])
    assert np.allclose(geometry.rotate(made, (0, 0, 1)), geometry.rotate(HOME, axis))
    assert np.linalg.det(geometry.to_matrix(made)[:3, :3]) == pytest.approx(1.0)


def test_a_full_turn_is_no_turn() -> None:
    assert hinges.angle_of(HOME, AXES[0], hinges.turned(HOME, AXES[0], 2.0 * math.pi + 0.2)) == pytest.approx(0.2)
