"""Sentences on paper: what they are predicted to do, each after those before it, and what that rests on."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rtc.protocol import causes, wire
from rtc.protocol.advice import sentences_of
from rtc.protocol.messages import Validity
from rtc.protocol.outcomes import RefusalReason, StopReason
from rtc.protocol.primitive import GoalReached, JointTrajectory, Primitive, StopFunction, TimeAbove
from rtc.wording.advice import in_one_line
from tests.workers.conftest import MODEL, record
from tests.workers.rehearsal.on_paper import SERVICING, OnPaper
from workers.rehearsal.rehearse import plain

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"
LIFT = "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM"


@pytest.fixture
def paper() -> OnPaper:
    return OnPaper()


def value(found, key: str):
    return next(fact for fact in found.rehearsal.changes if fact.key == key)


def test_a_feasible_sentence_states_its_steps_its_time_and_its_end(paper: OnPaper):
    found = paper.test(GRASP)
    steps, rehearsal = found.rehearsal.steps, found.rehearsal
    assert (found.refusal, [step.reason for step in steps].count("contact")) == (None, 2)
    assert rehearsal.predicted_s == pytest.approx(sum(step.predicted_s for step in steps))
    assert rehearsal.holding == {"RIGHT-ARM": "MACS-NEW"}
    assert rehearsal.ends["RIGHT-ARM"] == pytest.approx(steps[-1].tcp_pose, abs=1e-9)
    assert {"RIGHT-ARM", "MACS-NEW"} <= set(rehearsal.resources)
    assert steps[-1].grip_n == 30.0


def test_nothing_is_written(paper: OnPaper):
    before = dict(paper.world.facts)
    paper.test(GRASP)
    assert paper.world.facts == before


def test_a_sentence_sees_what_those_before_it_are_predicted_to_leave(paper: OnPaper):
    assert OnPaper().test(LIFT).refusal is not None
    grasped, lifted = paper.test(GRASP), paper.test(LIFT)
    assert lifted.refusal is None
    rise_m = value(lifted, "MACS-NEW.frame").value[2] - value(grasped, "MACS-NEW.frame").value[2]
    assert rise_m == pytest.approx(0.15, abs=0.002)
    assert lifted.rehearsal.steps[-1].carried_kg == pytest.approx(2.0)


def test_predicted_facts_have_their_spread_and_it_grows_in_the_hand(paper: OnPaper):
    grasped = value(paper.test(GRASP), "MACS-NEW.grasp").spread
    for sentence in (LIFT, "HOLD RIGHT-ARM FOR 60 SEC"):
        last = paper.test(sentence)
    held = next(fact for fact in last.after.facts if fact.key == "MACS-NEW.grasp").spread
    assert grasped is not None
    assert held is not None
    assert sum(held[:3]) > sum(grasped[:3])


@pytest.mark.parametrize(
    ("sentence", "keys"), [("LOCATE MACS-NEW", ["MACS-NEW.frame", "RACK-1.frame"]), (GRASP, ["MACS-NEW.frame"])]
)
def test_what_is_sensed_on_the_way_may_be_found_anywhere_that_was_possible(paper: OnPaper, sentence, keys):
    """The predicted pose had the spread of the look that was yet to come: most looks ended outside it."""
    before = paper.world.facts["MACS-NEW.frame"].spread
    found = paper.test(sentence)
    for key in keys:
        assert all(now >= was for now, was in zip(value(found, key).spread, before, strict=True))
    known = next(fact for fact in found.after.facts if fact.key == keys[0])
    assert known.spread[0] < 0.5 * before[0]  # the next sentence relies on what was sensed


def test_what_is_placed_is_found_where_its_seat_is(paper: OnPaper):
    for sentence in (GRASP, LIFT, "MOVE RIGHT-ARM TO BAY-2-FRONT"):
        assert paper.test(sentence).refusal is None
    placed = paper.test("INSERT MACS-NEW INTO BAY-2 WITH RIGHT-ARM")
    assert placed.refusal is None
    assert max(value(placed, "MACS-NEW.frame").spread[:3]) < 0.01


def test_it_relies_on_the_facts_that_it_read_with_their_versions(paper: OnPaper):
    paper.know("LEFT-ARM.joints", list(MODEL.cell.arm("LEFT-ARM").home_rad))
    found = paper.test("STOW RIGHT-ARM").rehearsal.relies_on
    assert found["RIGHT-ARM.joints"] == found["LEFT-ARM.joints"] == 7
    assert "RACK-1.mass" not in found


def test_facts_that_an_earlier_sentence_leaves_are_foreseen_not_relied_on(paper: OnPaper):
    paper.test("MOVE RIGHT-ARM TO BAY-2-FRONT")
    found = paper.test("STOW RIGHT-ARM").rehearsal
    assert "RIGHT-ARM.joints" in found.foreseen
    assert "RIGHT-ARM.joints" not in found.relies_on


def test_the_refused_step_is_named_and_nothing_changes(paper: OnPaper):
    paper.test(GRASP)
    before = paper.paper
    found = paper.test("MOVE RIGHT-ARM TO POSITION 300 0 50 CM")
    assert found.refusal is not None
    assert found.refusal.reason is RefusalReason.INFEASIBLE
    assert found.after == before


def test_a_later_step_of_a_sentence_may_be_the_one_that_is_refused():
    paper = OnPaper(SERVICING)
    found = paper.test("VERIFY MACS-NEW AT BAY-2 VIA CAMERA-1")  # seen where it is believed to be: in its rack
    assert found.refusal is not None
    assert found.step.startswith("1 of 1")


def test_a_whole_journey_through_a_door_is_feasible():
    paper = OnPaper(SERVICING)
    sentences = (
        *("GRASP LEFT-END-EFF DOOR-2 LATCH-PULL", "OPEN DOOR-2 BY 90 DEG WITH LEFT-ARM", "RELEASE DOOR-2"),
        *("SET BOLT-1 STATE LOOSE", "SET BOLT-2 STATE LOOSE"),
        *("GRASP RIGHT-END-EFF MACS-OLD HANDLE-A", "LIFT MACS-OLD BY 25 CM WITH RIGHT-ARM"),
        *("INSERT MACS-OLD INTO BAY-2 WITH RIGHT-ARM", "STOW RIGHT-ARM"),
    )
    assert [(text, paper.test(text).refusal) for text in sentences] == [(text, None) for text in sentences]
    angle = next(fact.value for fact in (paper.paper.facts if paper.paper else []) if fact.key == "DOOR-2.angle")
    assert angle == pytest.approx(1.5708, abs=0.002)


def test_exact_arms_refuse_what_must_give_way_and_do_the_rest():
    paper = OnPaper(SERVICING)
    paper.rigid = ["LEFT-ARM", "RIGHT-ARM"]
    grasp = paper.test("GRASP LEFT-END-EFF DOOR-2 LATCH-PULL")
    assert grasp.refusal is None
    assert grasp.rehearsal.steps[-2].reason == StopReason.REFUSED  # then a trim closes the hand without compliance
    opened = paper.test("OPEN DOOR-2 BY 60 DEG WITH LEFT-ARM")
    assert opened.refusal is not None
    assert opened.refusal.cause == causes.ExactArm(arm="LEFT-ARM")


# --- live motions ----------------------------------------------------------------------------------------


def moving(goal: list[float]) -> Primitive:
    home = list(MODEL.cell.arm("LEFT-ARM").home_rad)
    still = [[0.0] * len(home)] * 2
    path = JointTrajectory(
        space="joint", time_s=[0.0, 1.0], positions=[home, goal], velocities=still, accelerations=still
    )
    stops = [
        StopFunction(reason=StopReason.GOAL, when=GoalReached()),
        StopFunction(reason=StopReason.TIMEOUT, when=TimeAbove(5.0)),
    ]
    return Primitive(id="C-3.1", performer="LEFT-ARM", trajectory=path, stop_functions=stops)


def test_live_motions_count_as_ended_and_their_end_is_relied_on(paper: OnPaper):
    goal = list(MODEL.cell.arm("LEFT-ARM").stow_rad)
    found = paper.test("HOLD LEFT-ARM FOR 1 SEC", moving=[moving(goal)])
    assert found.rehearsal.ends["LEFT-ARM"] == pytest.approx(MODEL.arms["LEFT-ARM"].fk(goal).tolist())
    assert found.rehearsal.relies_on["LEFT-ARM.joints"] == 7  # the motion may end elsewhere


# --- order -----------------------------------------------------------------------------------------------


def test_a_sentence_that_lasts_keeps_its_arm_until_it_is_aborted(paper: OnPaper):
    lasting = paper.test("HOLD LEFT-ARM", "C-8")
    assert (lasting.rehearsal.steps[0].until_stopped, lasting.rehearsal.predicted_s) == (True, 0.0)
    blocked = paper.test("STOW LEFT-ARM", "C-9")
    assert blocked.refusal is not None
    assert (blocked.refusal.reason, blocked.refusal.owner) == (RefusalReason.RESOURCE, "C-8")
    assert paper.test("ABORT C-8", "C-10").refusal is None
    assert paper.test("STOW LEFT-ARM", "C-11").refusal is None


@pytest.mark.parametrize(
    ("sentence", "feasible"),
    [
        ("STOW LEFT-ARM AFTER C-8", True),
        ("STOW LEFT-ARM AFTER LAST", True),
        ("STOW LEFT-ARM AFTER C-4", True),  # it is in progress
        ("STOW LEFT-ARM AFTER C-5", False),
        ("STOW LEFT-ARM TOGETHER-WITH NOTHING", False),
        ("ABORT C-8", True),
        ("ABORT C-5", False),
        ("HALT", True),
        ("PAUSE RIGHT-ARM", True),
    ],
)
def test_other_sentences_are_named_by_their_labels_or_numbers(paper: OnPaper, sentence: str, feasible: bool):
    paper.test("STOW RIGHT-ARM", "C-8")
    found = paper.test(sentence, live=["C-4"])
    assert (found.refusal is None) is feasible
    if found.refusal is not None:
        assert found.refusal.reason is RefusalReason.NAME


def test_what_the_broker_itself_does_is_not_tested(paper: OnPaper):
    found = paper.test("LOAD CENTERING-GRASP INTO ELABORATOR")
    assert found.refusal is not None
    assert found.refusal.reason is RefusalReason.NO_SCRIPT
    assert "without TEST" in in_one_line(found.refusal.clears)


def test_a_carrier_is_not_looked_for_if_the_look_at_what_is_on_it_is_vague(paper: OnPaper):
    """LOCATE SATELLITE was advised, then LOCATE BAY-2 again, which was refused as before."""
    found = paper.test("LOCATE BAY-2")
    assert found.refusal is not None
    assert sentences_of(found.refusal.clears) == []


def test_a_stated_fact_is_there_for_the_next_sentence(paper: OnPaper):
    paper.test("SET MACS-NEW MASS 30 KG")
    paper.test(GRASP)
    found = paper.test(LIFT)
    assert found.refusal is not None
    assert found.refusal.cause.mass_kg == 30.0


def test_a_suspect_fact_is_refused_as_in_a_real_sentence(paper: OnPaper):
    paper.know("BAY-2.frame", MODEL.cell.seat("BAY-2").frame.pose.tolist(), Validity.SUSPECT)
    paper.test(GRASP)
    found = paper.test("PLACE MACS-NEW ON BAY-2")
    assert found.refusal is not None


def test_an_operator_is_assumed_to_do_what_is_asked(paper: OnPaper):
    found = paper.test("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A VIA OPERATOR-INTERVENTION")
    assert found.refusal is None
    assert found.rehearsal.holding["RIGHT-ARM"] == "MACS-NEW"
    assert len(found.rehearsal.assumes) == 3
    assert paper.test(LIFT).refusal is None


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("TEST STOW LEFT-ARM", "STOW LEFT-ARM"),
        ("test simulate STOW LEFT-ARM ASSUMING SLIP.", "STOW LEFT-ARM"),
        ("TEST MOVE LEFT-ARM TO TEST-SITE", "MOVE LEFT-ARM TO TEST-SITE"),
    ],
)
def test_the_sentence_of_a_test_is_without_test_and_without_the_assumed_fault(text: str, sentence: str):
    assert plain(text) == sentence


def test_the_record_is_that_of_the_sentence_that_may_be_given(paper: OnPaper):
    assert paper.test("STOW LEFT-ARM ASSUMING FAULTS").parsed == record("STOW LEFT-ARM")


def test_a_rehearsal_is_the_same_whatever_the_order_of_the_facts_in_its_view(paper: OnPaper):
    """Its recorded job is repeated with the same facts in another order: rtc replay compares the bytes."""
    other = OnPaper()
    other.world = replace(other.world, facts=dict(reversed(other.world.facts.items())))
    for sentence in (GRASP, LIFT):
        assert wire.encode(paper.test(sentence)) == wire.encode(other.test(sentence))
