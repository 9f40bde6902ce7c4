"""Spreads of things that were felt, and that are held."""

from __future__ import annotations

import math
import random

import pytest

from rtc.model.cells.parts import Numbers
from rtc.programs import loader
from rtc.spatial import geometry
from rtc.world.spread import even
from workers.analyzer import analyze
from workers.planning.pose_spread import (
    crept_spread,
    error_of,
    spread_after_measurement,
    spread_at,
    struck_spread,
    tipped_spread,
)

NUMBERS = Numbers(creep_m_s=0.0025 / 60, creep_rad_s=math.radians(1) / 60)
VALUES = {"struck_n": 40.0, "struck_m": 0.01, "struck_rad": 0.1, "twisted_n": 15.0, "twisted_rad": 0.04}
HANDLE = geometry.from_rpy([-0.15, -0.085, 0.0], [0.0, math.pi / 2, 0.0])  # of the module's handle, in its axes


def off_by(pose, error):
    """The pose, moved and turned by an error in its own axes."""
    return geometry.compose(pose, geometry.from_rpy(error[:3], error[3:]))


def test_an_error_of_attitude_moves_what_is_far_from_the_origin():
    found = spread_at([0.0, 0.0, 0.0, 0.0, 0.0, 0.1], (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    assert found == pytest.approx([0.0, 0.1, 0.0, 0.0, 0.0, 0.1])


@pytest.mark.parametrize("seed", range(20))
def test_what_is_carried_along_bounds_every_error_within_the_spread(seed):
    rng = random.Random(seed)
    spread = [rng.uniform(0, 0.03) for _ in range(3)] + [rng.uniform(0, 0.02) for _ in range(3)]
    error = [rng.uniform(-n, n) for n in spread]
    true = geometry.compose(off_by(geometry.IDENTITY, error), HANDLE)
    off = geometry.relative(HANDLE, true)
    found = [*off[:3], *geometry.to_rpy(off)]
    slack = 0.001  # small angles
    assert all(abs(e) <= bound + slack for e, bound in zip(found, spread_at(spread, HANDLE), strict=True))


def test_a_measurement_of_one_axis_leaves_the_others_as_they_were():
    before = [0.035, 0.035, 0.035, 0.0, 0.0, 0.0]
    seen = geometry.from_rpy([0.0, 0.004, 0.0], [0.0, 0.0, 0.0])
    assert spread_after_measurement(geometry.IDENTITY, seen, before, HANDLE, {1: 0.001}) == pytest.approx(
        [0.035, 0.001, 0.035, 0, 0, 0]
    )


def test_what_the_closing_fingers_felt_is_blurred_by_an_unmeasured_attitude():
    """The fingers know the handle, not the module's origin, 15 cm behind it."""
    before = [0.035, 0.035, 0.035, 0.0, 0.0, math.radians(5)]
    found = spread_after_measurement(geometry.IDENTITY, geometry.IDENTITY, before, HANDLE, {1: 0.001})
    assert found[1] == pytest.approx(0.001 + 0.15 * math.radians(5), abs=1e-4)
    assert found[5] == pytest.approx(math.radians(5))


def test_a_thing_that_was_moved_in_belief_along_an_axis_not_measured_is_known_less_there():
    seen = geometry.from_rpy([0.01, 0.0, 0.0], [0.0, 0.0, 0.0])
    assert spread_after_measurement(geometry.IDENTITY, seen, even(0.002, 0.0), HANDLE, {1: 0.001})[0] == pytest.approx(
        0.012, abs=1e-6
    )


def test_what_is_held_creeps_and_what_is_struck_turns():
    assert crept_spread(even(0.001, 0.0), 60.0, NUMBERS)[0] == pytest.approx(0.0035)
    assert crept_spread(even(0.001, 0.0), 0.0, NUMBERS) == pytest.approx(even(0.001, 0.0))
    grasp, before = geometry.IDENTITY, even(0.001, 0.0)
    assert struck_spread(before, grasp, 5.0, VALUES) == before
    assert struck_spread(before, grasp, 16.0, VALUES) == pytest.approx([0.001] * 3 + [0.02, 0.04, 0.0])
    assert struck_spread(before, grasp, 41.0, VALUES) == pytest.approx([0.011] * 3 + [0.12, 0.14, 0.1])


def test_what_is_held_moves_when_its_weight_comes_from_another_side() -> None:
    values, down = {"tipped_m": 0.001, "tipped_rad": 0.06}, (0.0, 0.0, -9.81)
    upright, aside = geometry.from_rpy((0, 0, 1), (0, 0, 0)), geometry.from_rpy((0, 0, 1), (0.5 * math.pi, 0, 0))
    turned = geometry.from_rpy((0, 0, 1), (0, 0, 1.0))  # about the plumb line
    before = even(0.001, 0.0)
    assert tipped_spread(before, upright, aside, down, values) == pytest.approx(
        even(0.001 + math.sqrt(2) * 0.001, math.sqrt(2) * 0.06)
    )
    assert tipped_spread(before, upright, turned, down, values) == pytest.approx(before)
    assert tipped_spread(before, upright, aside, (0.0, 0.0, 0.0), values) == pytest.approx(before)


def test_an_error_is_along_and_about_the_own_axes_of_the_pose() -> None:
    pose = geometry.from_rpy((1.0, 2.0, 3.0), (0.0, 0.0, 0.5 * math.pi))  # its x is the world's y
    true = geometry.compose(pose, geometry.from_rpy((0.001, 0.0, 0.0), (0.01, 0.0, 0.0)))
    assert error_of(pose, true) == pytest.approx([0.001, 0.0, 0.0, 0.01, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize(("peak_n", "turns"), [(11.0, False), (16.3, False), (22.0, True), (34.0, True)])
def test_what_reads_the_inertia_of_a_way_has_turned_nothing(peak_n, turns):
    """Readings of ways on which nothing was touched, and of touches that turned what is held by 1.1 and 2.0 deg."""
    values = analyze.compile(loader.default("analyzer")).values
    before = [0.001] * 3 + [0.02] * 3
    after = struck_spread(before, geometry.IDENTITY, peak_n, values)
    assert (after != before) is turns
