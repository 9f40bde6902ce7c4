"""Facts that a failure contradicts are suspect, and no next step relies on them (R151)."""

from __future__ import annotations

import msgspec
import pytest

from rtc.protocol.causes import NeedUnmet
from rtc.protocol.messages import Assessment, EndReport, Validity
from rtc.protocol.outcomes import RefusalReason, StopReason
from rtc.wording.advice import in_one_line
from workers.planning import pose_spread

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-B"
TOUCHED = [StopReason.COLLISION, StopReason.CONTACT, StopReason.FORCE_LIMIT, StopReason.FOLLOWING_ERROR]


def ended(bench, sentence: str, reason: StopReason, n: int = 0, **fields) -> Assessment:
    """The assessment of step n of a sentence that ends with this reason; its changes are in the world then."""
    script = bench.elaborate(sentence)
    bound = bench.bind(script, script.steps[n])
    report: EndReport = bench.subsystem.perform(bound.primitive, bound)
    made = bench.analyze(bound, msgspec.structs.replace(report, reason=reason, **fields), closing=True)
    bench.world = bench.world.overlay(made.changes, source="C-1/9")
    return made


def validity(bench, key: str) -> Validity:
    return bench.world.get(key).validity


@pytest.mark.parametrize("reason", TOUCHED)
def test_a_touch_on_a_free_path_makes_the_objects_near_the_arm_suspect(bench, reason) -> None:
    bench.unsurveyed()
    bench.without_cameras()  # which would look first
    ended(bench, GRASP, reason, 2)  # before the handle
    assert validity(bench, "MACS-NEW.frame") is Validity.SUSPECT
    assert validity(bench, "MACS-OLD.frame") is Validity.VALID  # the other rack is out of reach


@pytest.mark.parametrize("reason", [StopReason.TIMEOUT, StopReason.JOINT_LIMIT, StopReason.HALT])
def test_an_end_without_a_touch_contradicts_nothing(bench, reason) -> None:
    bench.unsurveyed()
    bench.without_cameras()  # which would look first
    ended(bench, GRASP, reason, 2)
    assert validity(bench, "MACS-NEW.frame") is Validity.VALID


def test_a_touch_of_another_command_makes_a_near_object_suspect_too(bench) -> None:
    """What has become of the world does not depend on the object of the sentence."""
    bench.unsurveyed()
    assert bench.do("APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM").succeeded
    ended(bench, "MOVE RIGHT-ARM BY 2 CM ALONG UP", StopReason.COLLISION)
    assert validity(bench, "MACS-NEW.frame") is Validity.SUSPECT


def test_a_contact_that_the_sentence_asks_for_contradicts_nothing(bench) -> None:
    assert bench.do("APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM").succeeded
    ended(bench, "MOVE RIGHT-ARM BY 1 CM ALONG UP UNLESS CONTACT THEN STOP", StopReason.CONTACT)
    assert validity(bench, "MACS-NEW.frame") is Validity.VALID


@pytest.fixture
def lost_while_closing(bench):
    """The controller died while the fingers closed."""
    bench.without_cameras()
    bench.do("MOVE RIGHT-ARM TO-GRASP-POINT-OF MACS-NEW")
    ended(bench, GRASP, StopReason.SUBSYSTEM_LOST, -1, joints=[], tcp_pose=[], wrench=[])
    return bench


def test_a_hand_that_was_lost_while_it_closed_may_hold_the_object(lost_while_closing) -> None:
    bench = lost_while_closing
    assert (bench.world.value("MACS-NEW.held_by"), bench.world.value("RIGHT-ARM.holding")) == ("RIGHT-ARM", "MACS-NEW")
    for key in ("MACS-NEW.held_by", "MACS-NEW.grasp", "MACS-NEW.frame", "RIGHT-ARM.holding"):
        assert validity(bench, key) is Validity.SUSPECT, key
    refusal = bench.elaborate("LIFT MACS-NEW BY 5 CM")
    assert (refusal.reason, in_one_line(refusal.clears)) == (RefusalReason.SUSPECT, "VERIFY MACS-NEW AT RIGHT-ARM")
    assert bench.elaborate(GRASP).reason is RefusalReason.STATE


def test_the_fingers_find_out_that_they_hold_it(lost_while_closing) -> None:
    bench = lost_while_closing
    assert bench.do("VERIFY MACS-NEW AT RIGHT-ARM").succeeded
    assert validity(bench, "MACS-NEW.held_by") is Validity.VALID
    assert bench.do("LIFT MACS-NEW BY 5 CM").succeeded


def test_the_fingers_find_out_that_they_do_not_hold_it(lost_while_closing) -> None:
    bench = lost_while_closing
    bench.subsystem.closes = [0.0]
    assert not bench.do("VERIFY MACS-NEW AT RIGHT-ARM").succeeded
    assert bench.world.value("RIGHT-ARM.holding") == bench.world.value("MACS-NEW.held_by") == ""


def doubt(bench, *keys: str) -> None:
    for key in keys:
        bench.set_fact(key, bench.world.value(key), Validity.SUSPECT)


MAY_HOLD = NeedUnmet(need="object_perhaps_held", by="RIGHT-ARM", doubt="MACS-NEW.held_by")


def test_an_object_that_a_hand_may_hold_is_not_taken_as_free(bench) -> None:
    """The analysis of a closure was lost: its facts are the earlier ones, and suspect."""
    bench.do("MOVE RIGHT-ARM TO-GRASP-POINT-OF MACS-NEW")
    doubt(bench, "RIGHT-ARM.holding", "RIGHT-ARM.hand_width", "MACS-NEW.held_by")
    refusal = bench.elaborate(GRASP)
    assert refusal.reason is RefusalReason.STATE
    assert refusal.cause == MAY_HOLD
    assert "OPEN RIGHT-ARM" in in_one_line(refusal.clears)
    assert bench.do("OPEN RIGHT-ARM").succeeded
    assert bench.do(GRASP).succeeded


def test_an_object_that_a_hand_may_hold_is_not_advised_to_be_grasped(bench) -> None:
    """Its report was lost while the hand opened: the hand may not be open."""
    bench.do("MOVE RIGHT-ARM TO-GRASP-POINT-OF MACS-NEW")
    doubt(bench, "RIGHT-ARM.holding", "RIGHT-ARM.hand_width", "MACS-NEW.held_by")
    for sentence in ("RELEASE MACS-NEW WITH RIGHT-ARM", "LIFT MACS-NEW BY 5 CM"):
        refusal = bench.elaborate(sentence)
        assert refusal.cause == MAY_HOLD
        assert "OPEN RIGHT-ARM" in in_one_line(refusal.clears)


def test_a_hand_far_away_cannot_hold_it(bench) -> None:
    doubt(bench, "RIGHT-ARM.holding", "RIGHT-ARM.hand_width", "MACS-NEW.held_by")
    assert bench.do(GRASP).succeeded


# --- the pose of what a hand has taken ---------------------------------------------------------------------

AFLOAT = {"MACS-NEW.seat": "", "MACS-NEW.grasp": None, "MACS-NEW.held_by": ""}


def spread_when_taken(bench, afloat: bool) -> list[float]:
    if afloat:
        for key, value in AFLOAT.items():
            bench.set_fact(key, value)
    assert bench.do(GRASP).succeeded
    assert bench.world.get("MACS-NEW.grasp").spread == bench.world.get("MACS-NEW.frame").spread
    return list(bench.world.get("MACS-NEW.grasp").spread)


def test_closing_fingers_move_a_free_object_in_ways_that_they_do_not_measure(bench) -> None:
    bench.without_cameras()
    moved_m, turned_rad = 0.034, 0.2  # in physics
    spread = spread_when_taken(bench, afloat=True)
    assert sum(n > moved_m for n in spread[:3]) == 2  # all but the closing axis
    assert max(spread[3:]) > turned_rad
    assert bench.do("LIFT MACS-NEW BY 15 CM").succeeded
    refusal = bench.elaborate("PLACE MACS-NEW ON BAY-2")
    assert (refusal.reason, refusal.where) == (RefusalReason.SUSPECT, "MACS-NEW.grasp")
    assert "SET MACS-NEW FRAME" in in_one_line(refusal.clears)


def test_closing_fingers_hardly_move_an_object_in_its_seat(bench) -> None:
    bench.without_cameras()
    assert max(spread_when_taken(bench, afloat=False)[:3]) < 0.005


def test_a_camera_measures_first_how_a_free_object_lies_in_the_hand(bench) -> None:
    spread_when_taken(bench, afloat=True)
    assert bench.do("LIFT MACS-NEW BY 15 CM").succeeded
    run = bench.do("PLACE MACS-NEW ON BAY-2")
    assert run.succeeded
    assert run.labels[0].startswith("look for MACS-NEW")


def test_a_look_measures_how_a_free_object_lies_in_the_hand(bench) -> None:
    spread_when_taken(bench, afloat=True)
    assert bench.do("LOCATE MACS-NEW").succeeded
    assert max(bench.world.get("MACS-NEW.grasp").spread[:3]) < 0.005


VERIFY = "VERIFY MACS-NEW AT RIGHT-ARM"
PLACE = "PLACE MACS-NEW ON BAY-2"


@pytest.fixture
def carried(bench):
    bench.without_cameras()
    for sentence in (GRASP, "LIFT MACS-NEW BY 15 CM"):
        assert bench.do(sentence).succeeded
    return bench


@pytest.mark.parametrize("reason", [*TOUCHED, StopReason.SLIP])
def test_fingers_do_not_measure_how_a_contact_has_turned_what_they_hold_along_the_pads(carried, reason) -> None:
    turned_m, turned_rad = 0.026, 0.187  # in physics
    bar = carried.model.cell.object("MACS-NEW").grasp_point("HANDLE-B").frame.pose
    ended(carried, PLACE, reason, peak_force_n=22.0)
    assert validity(carried, "MACS-NEW.grasp") is Validity.SUSPECT

    assert carried.do(VERIFY).succeeded

    assert validity(carried, "MACS-NEW.held_by") is Validity.VALID
    for key in ("MACS-NEW.grasp", "MACS-NEW.frame"):
        spread = carried.world.get(key).spread
        assert min(spread[:3]) >= turned_m, key
        about_bar, about_closing, about_approach = pose_spread.spread_at(spread, bar)[3:]
        assert about_closing >= turned_rad > max(about_bar, about_approach), key
    refusal = carried.elaborate(PLACE)
    assert (refusal.reason, refusal.where) == (RefusalReason.SUSPECT, "MACS-NEW.grasp")
    assert "SET MACS-NEW FRAME" in in_one_line(refusal.clears)
    assert carried.do("LIFT MACS-NEW BY 5 CM").succeeded


@pytest.mark.parametrize("reason", [StopReason.HALT, StopReason.TIMEOUT])
def test_fingers_clear_the_doubt_of_an_end_without_a_contact(carried, reason) -> None:
    ended(carried, PLACE, reason)
    assert validity(carried, "MACS-NEW.grasp") is Validity.SUSPECT
    for sentence in (VERIFY, PLACE):
        assert carried.do(sentence).succeeded


@pytest.mark.parametrize(("seat", "wider"), [("RACK-1", False), ("", True)])
def test_a_force_that_pulls_an_object_out_of_its_seat_does_not_turn_it_in_the_hand(bench, seat, wider) -> None:
    """In physics 58 N out of a seat moved it by 0.1 mm; the same force on an object that is free displaces it."""
    assert bench.do(GRASP).succeeded
    bench.set_fact("MACS-NEW.seat", seat)
    before = bench.world.get("MACS-NEW.grasp").spread
    ended(
        bench,
        "EXTRACT MACS-NEW FROM RACK-1" if seat else "LIFT MACS-NEW BY 15 CM",
        StopReason.GOAL,
        1,
        peak_force_n=58.0,
    )
    after = bench.world.get("MACS-NEW.grasp").spread
    assert (max(after[:3]) > max(before[:3]) + 0.005) == wider
