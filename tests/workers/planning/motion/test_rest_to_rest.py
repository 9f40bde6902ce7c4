"""Rest to rest: it arrives, at rest, within its limits, and no quicker way is there; also at the figures people say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtc.model.robot.quintic import Hermite
from workers.planning.motion.rest_to_rest import rest_to_rest


def assert_keeps(length, speed, acceleration, jerk):
    profile = rest_to_rest(length, speed, acceleration, jerk)
    place, v, a = profile.at(np.linspace(0.0, profile.duration_s, 101))
    assert (place[0], v[0], a[0]) == (0.0, 0.0, 0.0)
    assert place[-1] == pytest.approx(length, rel=1e-9)
    assert v[-1] == pytest.approx(0.0, abs=1e-9 * speed)
    assert a[-1] == pytest.approx(0.0, abs=1e-9 * acceleration)
    assert (np.diff(place) >= -1e-12 * length).all()
    assert v.max() <= speed * (1 + 1e-9)
    assert np.abs(a).max() <= acceleration * (1 + 1e-9)
    return profile


def test_any_length_with_any_limits():
    random = np.random.default_rng(1)
    for length, speed, acceleration, jerk in 10.0 ** random.uniform((-7, -3, -2, -1), (1, 0.5, 1, 2), (500, 4)):
        assert_keeps(length, speed, acceleration, jerk)


@pytest.mark.parametrize(("length", "acceleration"), [(0.005, 0.25), (0.01, 0.5), (0.02, 1.0)])
@pytest.mark.parametrize("speed", [0.05, 0.1, 0.25, 0.5])
def test_round_figures_and_their_neighbours(length, speed, acceleration):
    """10 mm at 0.5 m/s^2 with 0.1 s of ramp just reaches its acceleration: a searching solver lost it to rounding."""
    for off in range(-20, 21):
        assert_keeps(length + off * math.ulp(length), speed, acceleration, acceleration / 0.1)


def test_the_quickest():
    # 0.1 s ramps, full speed reached after 0.6 s and 0.15 m: 1.2 s for both ends, 0.7 m of cruise
    assert rest_to_rest(1.0, 0.5, 1.0, 10.0).duration_s == pytest.approx(1.2 + 0.7 / 0.5)
    # so short that not even the acceleration is reached: four ramps of equal length
    assert rest_to_rest(2e-3, 0.5, 10.0, 1.0).duration_s == pytest.approx(4 * (1e-3) ** (1 / 3))


@given(st.floats(1e-4, 10.0), st.floats(1e-3, 5.0), st.floats(1e-2, 20.0), st.floats(1e-1, 200.0))
def test_polynomials_between_the_ends_of_its_pieces_equal_the_profile(length, speed, acceleration, jerk):
    profile = rest_to_rest(length, speed, acceleration, jerk)
    knots_s = profile.knots_s
    assert len(knots_s) <= 8
    curve = Hermite(knots_s, *(rows[:, None] for rows in profile.at(knots_s)))
    times_s = np.linspace(0.0, profile.duration_s, 1000)
    for got, wanted in zip(np.moveaxis(curve.at(times_s)[:, :, 0], 1, 0), profile.at(times_s), strict=True):
        assert np.abs(got - wanted).max() < 1e-9 * max(1.0, acceleration)
