"""A primitive checks itself: a load and a time limit are figures that a servo can use."""

from __future__ import annotations

import math

import pytest

from rtc.protocol import wire
from rtc.protocol.primitive import MAX_FURTHER, HoldStill, Load, Partner, Primitive, StartAfter, TimeAbove
from tests.protocol.wire_examples import LAW, PATH, STOPS

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


WAIT = {"primitive": "C-6.1", "path_s": 1.0, "within_s": 9.0}


def test_a_condition_on_the_way_says_how_far_the_other_arm_must_be() -> None:
    condition = StartAfter(**WAIT, further=[(0.5, 1.5), (2.0, 3.0)])
    assert [condition.needed_s(own_s) for own_s in (0.0, 0.5, 0.6, 2.0, 2.1)] == [1.0, 1.0, 1.5, 1.5, 3.0]


def test_a_condition_without_any_on_the_way_travels_as_before() -> None:
    assert wire.encode(StartAfter(**WAIT)) == wire.encode(WAIT)


@pytest.mark.parametrize(
    "further",
    [
        [(0.0, 2.0)],
        [(0.5, 1.0)],
        [(0.5, 2.0), (0.5, 3.0)],
        [(0.5, 2.0), (0.6, 2.0)],
        [(math.nan, 2.0)],
        [(0.5, math.nan)],
        [(0.5, math.inf)],
        [(n + 1.0, n + 2.0) for n in range(MAX_FURTHER + 1)],
    ],
    ids=str,
)
def test_conditions_on_the_way_increase(further) -> None:
    with pytest.raises(ValueError, match="on the way"):
        StartAfter(**WAIT, further=further)


def test_only_a_motion_of_one_arm_waits_on_its_way() -> None:
    about = {"id": "C-7.1", "performer": "RIGHT-ARM", "stop_functions": STOPS}
    waits = [StartAfter(**WAIT, further=[(0.5, 1.5)])]
    assert Primitive(**about, trajectory=PATH, start_after=waits)
    with pytest.raises(ValueError, match="waits on its way"):
        Primitive(**about, trajectory=HoldStill(duration_s=1.0), start_after=waits)
    partner = Partner(performer="LEFT-ARM", trajectory=PATH, control_law=LAW, stop_functions=STOPS)
    with pytest.raises(ValueError, match="waits on its way"):
        Primitive(**about, trajectory=PATH, partner=partner, start_after=waits)
