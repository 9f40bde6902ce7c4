"""An arm in the way: the refusal names both bodies and states a sentence that clears it, tested by giving it."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from rtc.protocol.messages import Script, Validity, WorldChange
from rtc.spatial import geometry
from rtc.world.spread import even
from tests.workers.conftest import CELL, Bench
from workers.planning.motion import plan
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
    return refusal.clears[0].sentences[0]


@pytest.mark.parametrize("wanted", [TO_BAY, f"{TO_BAY} STRAIGHT-LINE"])
def test_the_sentence_of_the_refusal_clears_it(in_the_way, wanted):
    refusal = in_the_way.do(wanted).refusal
    assert refusal.in_the_way == "LEFT-ARM"
    assert {refusal.cause.body_a.split()[0], refusal.cause.body_b.split()[0]} == {"RIGHT-ARM", "LEFT-ARM"}
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
    refusal = in_the_way.do(TO_BAY).refusal
    assert not any(one.again for one in refusal.clears)  # no sentence after which the way is free
    assert refusal.in_the_way == "LEFT-ARM"


PLACE = "PLACE MACS-OLD ON RACK-2 WITH LEFT-ARM"


@pytest.fixture
def near(bench: Bench) -> Bench:
    """The left hand holds a module that may touch the satellite; the right arm stands beside it."""
    bench.without_cameras()
    bench.set_fact("LEFT-ARM.joints", [-0.574600, 1.058195, -3.602150, -0.666767, 1.062702, 0.299029])
    bench.set_fact("RIGHT-ARM.joints", [0.679806, 1.510722, -3.134227, 1.505713, 0.681516, -1.487073])
    place = geometry.from_rpy([0.6268, -0.0001, 0.6793], [-0.0564, 0.0159, -0.0037])
    tcp = bench.model.arms["LEFT-ARM"].fk(bench.world.value("LEFT-ARM.joints"))
    grasp = geometry.normalise(geometry.relative(tcp, place))
    stated = even(0.009, 0.058)
    holds = {
        "LEFT-ARM.hand_width": 0.02,
        "LEFT-ARM.holding": "MACS-OLD",
        "MACS-OLD.held_by": "LEFT-ARM",
        "MACS-OLD.seat": "",
    }
    for key, value in holds.items():
        bench.set_fact(key, value)
    for key, pose in (("MACS-OLD.frame", place), ("MACS-OLD.grasp", grasp)):
        change = WorldChange(key=key, value=pose.tolist(), spread=stated)
        bench.world = bench.world.overlay([change])
    return bench


def test_an_arm_leaves_what_it_may_touch_back_along_its_tool_before_a_way_is_sought(near: Bench) -> None:
    script = near.elaborate(PLACE)
    assert isinstance(script, Script), script
    arm = near.model.arms["LEFT-ARM"]
    before = arm.fk(near.world.value("LEFT-ARM.joints"))
    knots = next(step.way for step in script.steps if step.to and step.way is not None).knots
    straight, back = (geometry.relative(before, arm.fk(knot)) for knot in knots[1:3])
    assert back[2] in (pytest.approx(-by_m, abs=1e-4) for by_m in plan.BACK_M)
    assert straight[2] == pytest.approx(plan.STRAIGHT * back[2], abs=1e-4)
    assert [*straight[:2], *back[:2]] == pytest.approx([0.0] * 4, abs=1e-4)


@pytest.mark.parametrize(("distance_mm", "found"), [(20, True), (5, False)])
def test_an_arm_goes_back_first_if_a_search_fails_from_a_start_with_little_room(
    near: Bench, monkeypatch: pytest.MonkeyPatch, distance_mm: int, found: bool
) -> None:
    """The module is 25 mm from the satellite."""
    search, start = plan.find_sampled_way, near.world.value("LEFT-ARM.joints")

    def fails_at_the_start(request, *more):
        return 1 if np.allclose(request.start, start) else search(request, *more)

    monkeypatch.setattr(plan, "find_sampled_way", fails_at_the_start)
    monkeypatch.setattr(plan, "find_way_aside", lambda *_: None)
    for key in ("MACS-OLD.frame", "MACS-OLD.grasp"):
        near.set_fact(key, near.world.value(key))  # exactly known
    script = near.elaborate(f"{PLACE} MAINTAIN AVOID-NEIGHBORS BY {distance_mm} MM")
    assert isinstance(script, Script) == found, script
    assert not found or any(
        "back by" in note for step in script.steps if step.to and step.way for note in step.way.notes
    )


def test_no_arm_is_sent_away_from_a_way_that_would_not_be_free_without_it(
    near: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A module that may touch the satellite leaves on a line, or up and back: no other way is sought."""
    bench, wanted = near, PLACE
    with monkeypatch.context() as without:
        without.setattr(plan, "BACK_M", ())
        refusal = bench.elaborate(wanted)
    assert refusal.clears[0].sentences == ["RETRACT LEFT-ARM"]
    assert refusal.cause.leaving == "SATELLITE"
    bench.subsystem.widths["LEFT-ARM"] = 0.02
    bench.subsystem.joints["LEFT-ARM"] = np.array(bench.world.value("LEFT-ARM.joints"))
    assert bench.do("RETRACT LEFT-ARM").succeeded
    assert isinstance(bench.elaborate(wanted), Script)
