"""An arm in the way: the refusal names both bodies and states a sentence that clears it, tested by giving it."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from rtc.protocol.messages import Validity
from rtc.protocol.outcomes import IN_THE_WAY
from tests.workers.conftest import CELL, Bench
from workers.planning.robot_models import CellModel

TO_BAY = "MOVE RIGHT-ARM TO BAY-2-FRONT"
IN_THE_BAY = ["MOVE LEFT-ARM TO BAY-2-FRONT", "MOVE LEFT-ARM BY 15 CM ALONG RIGHT"]


@pytest.fixture
def in_the_way(bench: Bench) -> Bench:
    """The left arm is before the bay, on the side of the right arm."""
    for sentence in IN_THE_BAY:
        assert bench.do(sentence).succeeded
    return bench


def sentence_of(refusal) -> str:
    return refusal.clears.partition(";")[0]


@pytest.mark.parametrize("wanted", [TO_BAY, f"{TO_BAY} STRAIGHT-LINE"])
def test_the_sentence_of_the_refusal_clears_it(in_the_way, wanted):
    refusal = in_the_way.do(wanted).refusal
    assert refusal.detail[IN_THE_WAY] == "LEFT-ARM"
    assert {refusal.detail["body_a"].split()[0], refusal.detail["body_b"].split()[0]} == {"RIGHT-ARM", "LEFT-ARM"}
    assert sentence_of(refusal) == "STOW LEFT-ARM"
    assert in_the_way.do("STOW LEFT-ARM").succeeded
    assert in_the_way.do(wanted).succeeded


def test_a_place_is_stated_if_the_stowed_posture_is_in_the_way_too(in_the_way):
    left = CELL.arm("LEFT-ARM")
    blocking = [float(np.degrees(q)) for q in in_the_way.world.value("LEFT-ARM.joints")]
    arms = [arm if arm.name != left.name else msgspec.structs.replace(arm, stow_deg=blocking) for arm in CELL.arms]
    in_the_way.model = CellModel(msgspec.structs.replace(CELL, arms=arms))
    sentence = sentence_of(in_the_way.do(TO_BAY).refusal)
    assert sentence.startswith("MOVE LEFT-ARM TO ")
    assert in_the_way.do(sentence).succeeded
    assert in_the_way.do(TO_BAY).succeeded


def test_arms_that_block_each_other_are_freed_by_the_sentence_of_either(in_the_way):
    assert in_the_way.do("MOVE RIGHT-ARM TO CLEAR-POINT-1").succeeded
    across = "MOVE LEFT-ARM TO POSITION 48 -8.5 95 CM"  # where the right hand is
    for wanted, sentence in ((TO_BAY, "STOW LEFT-ARM"), (across, "STOW RIGHT-ARM")):
        assert sentence_of(in_the_way.do(wanted).refusal) == sentence
    assert in_the_way.do("STOW RIGHT-ARM").succeeded
    assert in_the_way.do(across).succeeded


def test_no_sentence_is_stated_for_an_arm_that_may_not_leave(in_the_way):
    in_the_way.set_fact("LEFT-ARM.holding", "MACS-OLD")
    in_the_way.set_fact("MACS-OLD.held_by", "LEFT-ARM")
    in_the_way.set_fact("MACS-OLD.grasp", in_the_way.world.value("MACS-OLD.frame"), Validity.SUSPECT)
    clears = in_the_way.do(TO_BAY).refusal.clears
    assert "STOW" not in clears
    assert "LEFT-ARM" in clears
