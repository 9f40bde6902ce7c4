"""How well a pose is known, as figures and in words."""

from __future__ import annotations

import math

import pytest

from rtc.model.cells.cell import Cell
from rtc.protocol.messages import Fact, Validity, WorldChange
from rtc.world.model import changed, initial_facts, problem
from rtc.world.spread import EXACT, even, exceeded, in_words, narrowest, widened

POSE = [0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0]
DOUBT = even(0.005, 0.02)


def fact(spread):
    return Fact(key="A.frame", value=POSE, validity=Validity.VALID, version=1, source="t", at_s=0.0, spread=spread)


def test_bounds_add_up_and_the_narrower_of_two_counts():
    assert widened([0.001] * 6, [0.002] * 6) == pytest.approx([0.003] * 6)
    assert narrowest([1, 2, 3, 4, 5, 6], [6, 5, 4, 3, 2, 1]) == [1, 2, 3, 3, 2, 1]


def test_words_put_equal_figures_together():
    assert in_words([0.035, 0.035, 0.035, 0.0, 0.0, math.radians(5)]) == "35 mm, roll 0 pitch 0 yaw 5 deg"
    assert in_words(even(0.005, math.radians(2))) == "5 mm, 2 deg"
    assert in_words(None) == ""


def test_an_axis_known_too_badly_is_named_with_what_is_needed():
    within = [0.004, 0.003, 0.004, 1.0, 1.0, 1.0]
    assert exceeded([0.004, 0.035, 0.001, 0.0, 0.0, 0.0], within) == ["y 35 mm (3 mm needed)"]
    assert exceeded(None, EXACT) == []


def test_a_change_of_validity_keeps_the_spread_and_a_new_value_has_its_own():
    old = fact(DOUBT)
    suspect = WorldChange(key="A.frame", keep_value=True, validity=Validity.SUSPECT)
    assert changed(old, suspect, 2, "t", 0.0).spread == DOUBT
    wider = WorldChange(key="A.frame", keep_value=True, spread=even(0.01, 0.02))
    assert changed(old, wider, 2, "t", 0.0).spread == even(0.01, 0.02)
    assert changed(old, WorldChange(key="A.frame", value=POSE), 2, "t", 0.0).spread is None


@pytest.mark.parametrize("spread", [[-0.001, 0, 0, 0, 0, 0], [math.nan, 0, 0, 0, 0, 0], [math.inf] * 6])
def test_a_spread_that_is_no_bound_is_not_written(spread):
    assert "spread" in problem(WorldChange(key="A.frame", value=POSE, spread=spread))


def test_the_cell_says_how_well_the_place_of_a_module_is_known_at_first():
    facts = {change.key: change for change in initial_facts(Cell.load("swapout"))}
    assert in_words(facts["MACS-NEW.frame"].spread) == "35 mm, 5 deg"
    assert facts["SATELLITE.frame"].spread is None
