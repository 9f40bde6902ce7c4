"""A primitive checks itself: a load and a time limit are figures that a servo can use."""

from __future__ import annotations

import math

import pytest

from rtc.protocol.primitive import Load, TimeAbove

GOOD = {"mass_kg": 2.0, "com_m": [0.0, -0.085, 0.15], "inertia_kg_m2": [0.0145, 0.0125, 0.0165, 0.001, 0.0, 0.0]}


def test_the_load_of_a_module_is_a_load() -> None:
    assert Load(**GOOD).mass_kg == 2.0
    assert Load(mass_kg=1.0, com_m=[0.0] * 3, inertia_kg_m2=[0.0] * 6).mass_kg == 1.0  # of a point


@pytest.mark.parametrize(
    "change",
    [
        {"mass_kg": 1e308},
        {"mass_kg": math.nan},
        {"mass_kg": 0.0},
        {"mass_kg": -1.0},
        {"com_m": [math.nan] * 3},
        {"com_m": [0.0, 11.0, 0.0]},
        {"com_m": [0.0]},
        {"inertia_kg_m2": [-1.0] * 6},
        {"inertia_kg_m2": [math.inf] * 6},
        {"inertia_kg_m2": [0.01, 0.01, 0.01, 0.0, 0.0, 0.02]},
        {"inertia_kg_m2": [0.01, 0.01, 0.01, math.nan, 0.0, 0.0]},
        {"inertia_kg_m2": [0.01]},
    ],
    ids=str,
)
def test_figures_that_no_body_has_are_no_load(change) -> None:
    with pytest.raises(ValueError, match="a load"):
        Load(**{**GOOD, **change})


@pytest.mark.parametrize("limit_s", [math.nan, math.inf, -1.0, 1e300])
def test_a_time_limit_ends(limit_s: float) -> None:
    with pytest.raises(ValueError, match="a time limit"):
        TimeAbove(limit_s)
