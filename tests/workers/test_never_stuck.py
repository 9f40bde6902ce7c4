"""From every end of a command a sentence leads on: out of what it touches, and out of what is in doubt."""

from __future__ import annotations

import numpy as np
import pytest

from rtc.protocol import causes
from rtc.protocol.advice import sentences_of
from rtc.protocol.causes import NeedUnmet
from rtc.protocol.messages import Script, Validity, WorldChange
from rtc.protocol.outcomes import RefusalReason, StopReason
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line
from rtc.world.spread import even, widened
from tests.campaigns import left_alone
from tests.campaigns.after_stops import Drawn, halt_and_follow
from tests.workers.conftest import Bench

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"
CARRY = "MOVE RIGHT-ARM TO BAY-2-FRONT"
SAME_PLACE = "SET MACS-NEW FRAME 80 -80 60 CM"


@pytest.fixture
def in_the_handle(either):
    """A search that has felt nothing ends 10 mm inside the handle as it is believed. No camera helps."""
    either.without_cameras()
    stay = "skill: grasp\nsteps: [{do: hold, stop: hold, label: stay, args: {duration_s: 0.0}}]"
    either.load("elaborator", stay)  # not drawn back, as by one who is halted then
    either.load("elaborator", "command_object_table: [{verb: GRASP, name: MACS-NEW, values: {trim_m: 0.0}}]")
    either.subsystem.displace("MACS-NEW", [0.0, 0.020, 0.0])
    run = either.do(GRASP)
    assert run.failure.reason is StopReason.NO_CONTACT
    return either


def test_out_of_a_handle_that_is_in_doubt(in_the_handle):
    assert in_the_handle.world.get("MACS-NEW.frame").validity is Validity.SUSPECT
    assert in_the_handle.do("RETRACT RIGHT-ARM").succeeded
    assert in_the_handle.do("STOW RIGHT-ARM").succeeded


@pytest.mark.parametrize("sentence", ["RETRACT RIGHT-ARM BY 20 CM", "MOVE RIGHT-ARM BY -4 CM ALONG Y", GRASP])
def test_out_of_a_handle_that_is_stated_to_be_there_after_all(in_the_handle, sentence):
    assert in_the_handle.do(SAME_PLACE).succeeded
    run = in_the_handle.do(sentence)
    assert run.refusal is None, run.refusal
    assert run.succeeded or run.failure.reason == "no_contact"


def test_out_of_a_handle_that_is_known_within_millimetres_straight_back_first(in_the_handle):
    assert in_the_handle.do(SAME_PLACE).succeeded
    refusal = in_the_handle.do("STOW RIGHT-ARM").refusal
    assert refusal.clears[0].sentences == ["RETRACT RIGHT-ARM"]
    for sentence in ("RETRACT RIGHT-ARM", "STOW RIGHT-ARM"):
        assert in_the_handle.do(sentence).succeeded


@pytest.mark.physics
def test_on_physics_out_of_a_handle_that_is_not_where_it_is_believed_to_be(physical):
    """A GRASP is halted while the fingers are around a handle that may be 35 mm off, and is 20 mm off."""
    physical.unsurveyed()
    physical.without_cameras()
    physical.subsystem.displace("MACS-NEW", [0.0, 0.020, 0.0])
    script = physical.elaborate(GRASP)
    straddle = next(n for n, step in enumerate(script.steps) if step.label.startswith("straddle"))
    for n, step in enumerate(script.steps[: straddle + 1], 1):
        bound = physical.bind(script, step, n=n)
        if bound.primitive is not None:
            made = physical.analyze(bound, physical.subsystem.perform(bound.primitive, bound))
            physical.world = physical.world.overlay(made.changes)
    before = physical.subsystem.sim.truth()["poses"]["MACS-NEW"]

    refused = physical.do("STOW RIGHT-ARM")
    assert not refused.primitives
    for sentence in (*refused.refusal.clears[0].sentences, "STOW RIGHT-ARM"):
        run = physical.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.assessments)
        assert run.reports[-1].peak_force_n < 3.0
    assert geometry.distance(physical.subsystem.sim.truth()["poses"]["MACS-NEW"], before) < 1e-4


def test_deeper_into_a_handle_stays_refused(in_the_handle):
    in_the_handle.do(SAME_PLACE)
    refusal = in_the_handle.do("MOVE RIGHT-ARM BY 1 CM ALONG Y STRAIGHT-LINE").refusal
    assert isinstance(refusal.cause, causes.Collides)


@pytest.mark.parametrize(("what", "then"), [("operator", "page closed"), ("pause", "another sentence")])
def test_what_waits_for_an_arm_that_was_left_alone_says_what_frees_it(what, then):
    sentence = "GIVE RIGHT-ARM TO OPERATOR" if what == "operator" else "MOVE RIGHT-ARM TO CLEAR-POINT-1"
    twist = [0.0, 0.0, 0.05, 0.0, 0.0, 0.0]
    drawn = left_alone.Drawn(what, "home", "RIGHT-ARM", sentence, "STOW RIGHT-ARM", then, after_s=0.2, twist=twist)
    found = left_alone.leave_alone(drawn)
    assert found is not None
    assert found.end == "done", found


# --- letting go ----------------------------------------------------------------------------------------------


@pytest.fixture
def in_the_air(bench):
    bench.without_cameras()
    for sentence in (GRASP, "LIFT MACS-NEW BY 15 CM"):
        assert bench.do(sentence).succeeded
    return bench


def test_nothing_is_released_in_the_air_unless_commanded(in_the_air):
    refusal = in_the_air.do("RELEASE MACS-NEW").refusal

    assert refusal.reason is RefusalReason.STATE
    assert refusal.cause == NeedUnmet(need="object_seated", by="MACS-NEW")
    assert sentences_of(refusal.clears) == ["PLACE MACS-NEW ON RACK-1", "RELEASE MACS-NEW VIA FREE-DRIFT"]


def test_an_object_released_in_the_air_is_in_doubt_until_its_pose_is_stated(in_the_air):
    assert in_the_air.do("RELEASE MACS-NEW VIA FREE-DRIFT").succeeded

    assert in_the_air.world.value("RIGHT-ARM.holding") == ""
    assert in_the_air.world.get("MACS-NEW.frame").validity is Validity.SUSPECT
    assert "SET MACS-NEW FRAME" in in_one_line(in_the_air.do(GRASP).refusal.clears)
    assert in_the_air.do("RETRACT RIGHT-ARM BY 5 CM").succeeded
    assert in_the_air.do("STOW RIGHT-ARM").succeeded
    assert in_the_air.do("SET MACS-NEW FRAME 78 -78 80 CM 0 0 -10 DEG").succeeded
    assert in_the_air.do("APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM").refusal is None


def test_a_module_is_let_go_of_in_its_seat_and_taken_again(bench):
    for sentence in (GRASP, "RELEASE MACS-NEW", GRASP):
        assert bench.do(sentence).succeeded, sentence


def test_half_way_out_of_its_seat_is_no_place_to_let_go(bench):
    for sentence in (GRASP, "LIFT MACS-NEW BY 5 CM"):
        assert bench.do(sentence).succeeded
    assert bench.world.value("MACS-NEW.seat") == "RACK-1"  # not yet free of it
    assert bench.do("RELEASE MACS-NEW").refusal.cause == NeedUnmet(need="object_seated", by="MACS-NEW")


def test_free_drift_is_a_strategy_of_one_verb(bench):
    bench.do(GRASP)
    for sentence in ("LIFT MACS-NEW VIA FREE-DRIFT", "RELEASE MACS-NEW VIA CAMERA-1"):
        assert bench.do(sentence).refusal.reason is RefusalReason.NAME


def test_the_refusal_for_a_full_hand_in_the_air_names_a_free_seat(in_the_air):
    refusal = in_the_air.do("GRASP MACS-OLD WITH RIGHT-ARM").refusal
    assert sentences_of(refusal.clears) == ["PLACE MACS-NEW ON RACK-1", "GRASP MACS-OLD WITH LEFT-ARM"]
    assert in_the_air.do("PLACE MACS-NEW ON RACK-1").succeeded


# --- a hand that was only to close -----------------------------------------------------------------------------


@pytest.mark.parametrize(("closed_to_m", "validity"), [(0.02, Validity.SUSPECT), (0.0, Validity.VALID)])
def test_a_hand_closed_round_a_handle_leaves_the_place_of_the_thing_in_doubt(bench, closed_to_m, validity):
    """After a halt in the grasp, say: the hand presses, and is believed to hold nothing."""
    assert bench.do("APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM").succeeded
    assert bench.do("MOVE RIGHT-ARM BY 10 CM ALONG TOOL-Z").succeeded
    bench.subsystem.closes = [closed_to_m]

    assert bench.do("CLOSE RIGHT-ARM").succeeded

    assert bench.world.get("MACS-NEW.frame").validity is validity
    assert bench.world.get("MACS-OLD.frame").validity is Validity.VALID
    assert bench.do("RETRACT RIGHT-ARM").refusal is None
    assert bench.do("OPEN RIGHT-ARM").succeeded


@pytest.mark.physics
def test_on_physics_out_of_a_handle_that_is_believed_to_be_between_finger_and_palm(physical):
    """The hand straddles the handle; the stated pose has, wrongly, a finger stands 10 mm deep in it."""
    for sentence in (
        "APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM",
        "MOVE RIGHT-ARM BY 10 CM ALONG TOOL-Z",
        "SET MACS-NEW FRAME 80 -76 60 CM",
        "RETRACT RIGHT-ARM",
        "STOW RIGHT-ARM",
        "SET MACS-NEW SEAT RACK-1",
        GRASP,
    ):
        run = physical.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.assessments)


def test_a_module_that_is_less_certain_than_its_distance_is_looked_for_before_it_is_carried(bench: Bench) -> None:
    """It creeps in the fingers while the arm moves. In the end it may be as near to the rack as it stands."""
    bench.unsurveyed()
    for sentence in ("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM"):
        assert bench.do(sentence).succeeded
    script = bench.elaborate(CARRY)
    assert isinstance(script, Script)
    assert not script.steps[0].label.startswith("look")
    spread = widened(bench.world.get("MACS-NEW.grasp").spread, even(0.006, 0.03))
    bench.world = bench.world.overlay([WorldChange(key="MACS-NEW.grasp", keep_value=True, spread=spread)])
    run = bench.do(CARRY)
    assert run.succeeded, (run.refusal, run.assessments)
    assert run.labels[0].startswith("look for MACS-NEW")


# --- halted when nearly all is done ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "drawn",
    [
        Drawn("both", "RIGHT-ARM", "HANDOFF MACS-NEW FROM RIGHT-ARM TO LEFT-ARM", 1, 0.4),  # it backs off
        Drawn("lifted", "LEFT-ARM", "INSERT MACS-OLD INTO BAY-2 WITH LEFT-ARM", 5, 0.2),  # it backs off
        Drawn("seated", "RIGHT-ARM", "RELEASE MACS-NEW WITH RIGHT-ARM", 1, 0.5),
        Drawn("seated", "LEFT-ARM", "EXTRACT MACS-OLD FROM RACK-2", 2, 0.3),  # out of its seat, and not yet clear
        Drawn("open door", "LEFT-ARM", "OPEN DOOR-2 BY 20 DEG WITH LEFT-ARM", 1, 0.9),  # the door has turned as far
        Drawn("lifted", "RIGHT-ARM", "MOVE RIGHT-ARM BY -5.1 CM ALONG Z", 1, 0.9),
    ],
)
def test_a_halt_at_the_end_of_a_task_is_followed_by_what_frees_the_arm(drawn):
    """The same sentence again was refused with advice that undoes the task, or would have done more than was asked."""
    ran = halt_and_follow(drawn, np.random.default_rng(1))
    assert ran is not None
    assert ran.end == "done", ran.story
    assert ran.given <= 3


@pytest.mark.parametrize("sentence", ["RETRACT RIGHT-ARM", "MOVE RIGHT-ARM BY 5 CM ALONG UP"])
def test_a_motion_says_that_it_takes_a_module_along_that_is_in_its_seat(bench, sentence):
    assert bench.do(GRASP).succeeded
    run = bench.do(sentence)
    assert run.succeeded, run.refusal
    assert any("MACS-NEW, which is in RACK-1, goes with the hand" in one.remark for one in run.assessments)
    assert not any("goes with" in one.remark for one in bench.do("LIFT MACS-NEW BY 15 CM").assessments)
    assert not any("goes with" in one.remark for one in bench.do("MOVE RIGHT-ARM TO CLEAR-POINT-1").assessments)
