"""Taught places and the reset of facts, from the sentence to the world and to a motion."""

from __future__ import annotations

import pytest

from rtc.protocol.advice import sentences_of
from rtc.protocol.messages import Validity
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.world.model import initial_facts, location

KEY = "P1.posture_of_right_arm"
TEACH = "SET P1 POSTURE-OF-RIGHT-ARM HERE"
ARM = "RIGHT-ARM"


def succeeds(bench, *sentences: str) -> None:
    for sentence in sentences:
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.assessments)


def refused(bench, sentence: str) -> Refusal:
    run = bench.do(sentence)
    assert run.refusal is not None, run
    assert run.primitives == []
    return run.refusal


def test_a_taught_place_is_a_place_like_any_other(bench):
    succeeds(bench, "MOVE RIGHT-ARM BY 5 CM ALONG UP")
    there = bench.world.value(f"{ARM}.joints")
    succeeds(bench, TEACH, "STOW RIGHT-ARM", "MOVE RIGHT-ARM TO P1")
    assert bench.world.value(f"{ARM}.joints") == pytest.approx(there, abs=1e-6)
    assert bench.world.value(KEY) == pytest.approx(there)


def test_it_is_claimed_with_the_arm_so_that_no_motion_runs_meanwhile(bench):
    script = bench.elaborate(TEACH)
    assert set(script.resources) == {"P1", ARM}
    assert set(script.writes) == {"P1", ARM}


def test_an_unknown_place_is_like_a_taught_one(bench):
    succeeds(bench, "SET DOCK-1 POSTURE-OF-RIGHT-ARM HERE")
    unknown = refused(bench, "MOVE RIGHT-ARM TO DOKC-1")
    assert unknown.nearest == ["DOCK-1"]
    assert refused(bench, "MOVE LEFT-ARM TO DOCK-1").expected == [ARM]  # it has no posture there


def test_joints_that_are_not_valid_are_not_taught(bench):
    bench.set_fact(f"{ARM}.joints", bench.world.value(f"{ARM}.joints"), Validity.SUSPECT)
    refusal = refused(bench, TEACH)
    assert refusal.reason is RefusalReason.SUSPECT
    succeeds(bench, refusal.clears[0].sentences[0], TEACH)


@pytest.mark.parametrize("name", ["RACK-1", "MACS-NEW", "CLEAR-POINT-1", "UP", "CAMERA-1", "WORLD"])
def test_a_name_that_is_taken_is_refused(bench, name):
    refusal = refused(bench, f"SET {name} POSTURE-OF-RIGHT-ARM HERE")
    assert refusal.reason is RefusalReason.NAME
    assert refusal.where == name


def test_angles_may_be_given_within_the_limits(bench):
    succeeds(bench, "SET P1 POSTURE-OF-RIGHT-ARM 0 110 -160 0 50 0 DEG")
    assert len(bench.world.value(KEY)) == 6
    assert refused(bench, "SET P1 POSTURE-OF-RIGHT-ARM 0 0 0 0 0 500 DEG").reason is RefusalReason.INFEASIBLE
    assert sentences_of(refused(bench, "SET P1 POSTURE-OF-RIGHT-ARM 0 0 DEG").clears) == [TEACH]
    assert refused(bench, "SET P1 POSTURE-OF-RIGHT-AMR HERE").nearest == [ARM]


def test_a_forgotten_place_is_unknown_again(bench):
    succeeds(bench, TEACH, "SET P1 POSTURE-OF-RIGHT-ARM NONE")
    assert refused(bench, "MOVE RIGHT-ARM TO P1").reason is RefusalReason.NAME
    assert refused(bench, "SET P1 POSTURE-OF-RIGHT-ARM NONE").reason is RefusalReason.NAME


# --- reset -------------------------------------------------------------------------------------------------


def test_a_reset_restores_all_facts_of_things_and_none_of_arms(bench):
    succeeds(bench, "MOVE RIGHT-ARM BY 5 CM ALONG UP", TEACH)
    succeeds(bench, "SET MACS-NEW FRAME 80 -70 60 CM", "SET RACK-1 FRAME 81 -80 60 CM", "SET MACS-NEW MASS 3 KG")
    bench.set_fact("MACS-OLD.frame", bench.world.value("MACS-OLD.frame"), Validity.SUSPECT)
    before = {key: fact for key, fact in bench.world.facts.items() if location(key) in (ARM, "LEFT-ARM", "P1")}
    succeeds(bench, "SET WORLD FACTS INITIAL")
    arms = {arm.name for arm in bench.model.cell.arms}
    for change in initial_facts(bench.model.cell):
        fact = bench.world.get(change.key)
        if location(change.key) not in arms:
            assert (fact.value, fact.validity, fact.spread) == (change.value, Validity.VALID, change.spread), fact
    assert bench.world.value("RACK-1.frame") == pytest.approx(bench.model.cell.seat("RACK-1").frame.pose.tolist())
    assert {key: bench.world.get(key) for key in before} == before


def test_a_reset_claims_everything_that_it_writes(bench):
    script = bench.elaborate("SET WORLD FACTS INITIAL")
    assert {ARM, "LEFT-ARM", "MACS-NEW", "RACK-1"} <= set(script.resources)
    assert set(script.writes) == set(script.resources)


def test_a_reset_is_refused_while_a_hand_holds_something(bench):
    succeeds(bench, "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
    refusal = refused(bench, "SET WORLD FACTS INITIAL")
    assert refusal.where == "MACS-NEW"
    succeeds(bench, refusal.clears[0].sentences[0], "SET WORLD FACTS INITIAL")


def test_of_the_world_nothing_else_can_be_set(bench):
    assert sentences_of(refused(bench, "SET WORLD FRAME 0 0 0 CM").clears) == ["SET WORLD FACTS INITIAL"]
