"""Boxes of a load against a box that stands, compared with an exact distance and with all corners."""

from __future__ import annotations

import coal
import numpy as np
import pytest

from rtc.spatial import geometry
from rtc.spatial.solid_boxes import CORNERS, Beside

RNG = np.random.default_rng(3)


def drawn_pose(reach_m: float) -> np.ndarray:
    turn = RNG.normal(size=4)
    return np.array([*RNG.uniform(-reach_m, reach_m, 3), *(turn / np.linalg.norm(turn))])


def placed(pose: np.ndarray) -> coal.Transform3s:
    matrix = geometry.to_matrix(pose)
    return coal.Transform3s(matrix[:3, :3], matrix[:3, 3])


CASES = [
    (drawn_pose(0.3), RNG.uniform(0.05, 0.5, 3), drawn_pose(0.3), drawn_pose(0.2), RNG.uniform(0.02, 0.4, 3))
    for _ in range(400)
]


def test_a_box_is_inside_another_when_an_exact_distance_says_so() -> None:
    found = [0, 0]
    for centre, sides, hand, at, size in CASES:
        box, standing = (coal.Box(*size), placed(geometry.compose(hand, at))), (coal.Box(*sides), placed(centre))
        exact = coal.distance(*standing, *box, coal.DistanceRequest(), coal.DistanceResult())
        deep = Beside([[*at, *size]], centre, sides).inside_m(hand)
        if abs(exact) > 1e-6:
            assert (deep > 0.0) is (exact < 0.0), (centre, sides, hand, at, size)
            found[exact < 0.0] += 1
    assert min(found) > 50


def test_the_farthest_corner_counts() -> None:
    for centre, sides, hand, at, size in CASES[:50]:
        corners = [geometry.transform_point(geometry.compose(hand, at), corner * size) for corner in CORNERS]
        local = [np.abs(geometry.transform_point(geometry.inverse(centre), corner)) for corner in corners]
        expected = max(float((one - 0.5 * sides).max()) for one in local)
        assert Beside([[*at, *size]], centre, sides).beyond_m(hand) == pytest.approx(expected, abs=1e-9)


def test_of_several_boxes_the_deepest_counts() -> None:
    far, near = [0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 1.0, 0.1, 0.1, 0.1], [0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.1, 0.1, 0.1]
    beside = Beside([far, near], geometry.IDENTITY, [0.14, 1.0, 1.0])
    assert beside.inside_m(geometry.IDENTITY) == pytest.approx(0.02)
    assert Beside([far], geometry.IDENTITY, [0.14, 1.0, 1.0]).inside_m(geometry.IDENTITY) < 0.0
