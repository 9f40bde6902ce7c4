"""Stated facts of an object, from the sentence to the world, and those that are refused."""

from __future__ import annotations

import math

import pytest

from rtc.protocol import causes
from rtc.protocol.messages import BoundStep, Script, Validity
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"


def state(bench, sentence: str) -> None:
    run = bench.do(sentence)
    assert run.succeeded, (run.refusal, run.assessments)
    assert run.primitives == []  # nothing has moved


def refused(bench, sentence: str) -> Refusal:
    run = bench.do(sentence)
    assert run.refusal is not None, run
    return run.refusal


# --- believed ----------------------------------------------------------------------------------------------


def test_a_suspect_frame_is_trusted_again_when_it_is_stated(bench):
    bench.without_cameras()
    bench.set_fact("MACS-NEW.frame", bench.world.value("MACS-NEW.frame"), Validity.SUSPECT)
    assert refused(bench, GRASP).reason is RefusalReason.SUSPECT

    state(bench, "SET MACS-NEW FRAME 80 -80 60 CM")

    assert bench.world.get("MACS-NEW.frame").validity is Validity.VALID
    assert bench.do(GRASP).succeeded


def test_what_the_refusal_says_would_clear_it_clears_it(bench):
    bench.without_cameras()
    bench.set_fact("MACS-NEW.frame", [0.7912, -0.8, 0.6, 0, 0, 0, 1], Validity.SUSPECT)
    advice = refused(bench, GRASP).clears

    state(bench, advice[0].sentences[0])

    assert bench.world.value("MACS-NEW.frame") == pytest.approx([0.7912, -0.8, 0.6, 0, 0, 0, 1])
    assert isinstance(bench.elaborate(GRASP), Script)


def test_the_refusal_says_how_the_thing_is_turned(bench):
    bench.without_cameras()
    askew = geometry.from_rpy([0.79, -0.80, 0.60], [0.0, 0.0, math.radians(12)])
    bench.set_fact("MACS-NEW.frame", askew.tolist(), Validity.SUSPECT)
    advice = refused(bench, GRASP).clears[0].sentences[0]

    assert advice == "SET MACS-NEW FRAME 79 -80 60 CM 0 0 12 DEG"
    state(bench, advice)

    assert geometry.angle(bench.world.value("MACS-NEW.frame"), askew) < 1e-3


def test_it_is_an_analyzer_that_writes_what_was_stated(bench):
    """A24: the binder makes a report of it, which changes nothing yet."""
    script = bench.elaborate("SET MACS-NEW MASS 2.1 KG")
    bound = bench.bind(script, script.steps[0])

    assert isinstance(bound, BoundStep)
    assert bound.primitive is None
    assert bound.subsystem == ""
    assert bound.report.facts == {"MACS-NEW.mass": 2.1}
    changes = bench.analyze(bound, bound.report).changes
    assert [(c.key, c.value, c.validity) for c in changes] == [("MACS-NEW.mass", 2.1, Validity.VALID)]


def test_it_claims_the_thing_alone_and_no_arm(bench):
    bench.do(GRASP)  # what the nearest arm holds is none of its business
    script = bench.elaborate("SET MACS-OLD MASS 2.1 KG")

    assert script.resources == ["MACS-OLD"]
    assert script.writes == ["MACS-OLD"]
    assert script.context.arm == ""


def test_what_is_stated_of_a_thing_in_a_hand_is_within_what_the_script_writes(bench):
    """The world database takes no other change; the arm must not move meanwhile."""
    bench.do(GRASP)
    script = bench.elaborate("SET MACS-NEW ATTITUDE 0 0 0 DEG")
    bound = bench.bind(script, script.steps[0])
    changes = bench.analyze(bound, bound.report).changes

    assert {change.key.partition(".")[0] for change in changes} == {"MACS-NEW", "RIGHT-ARM"}
    assert set(script.writes) == set(script.resources) == {"MACS-NEW", "RIGHT-ARM"}


def test_a_position_keeps_the_attitude_believed_so_far(bench):
    askew = geometry.from_rpy([0.5, 0.1, 0.4], [0.0, 0.1, 0.3]).tolist()
    bench.set_fact("MACS-NEW.frame", askew, Validity.SUSPECT)

    state(bench, "SET MACS-NEW FRAME 70 10 40 CM")

    assert bench.world.value("MACS-NEW.frame") == pytest.approx([0.7, 0.1, 0.4, *askew[3:]])


@pytest.mark.parametrize(
    ("sentence", "seat"),
    [
        ("SET MACS-NEW FRAME 81 -80 60 CM", "RACK-1"),  # a centimetre off its seat: it has been pushed
        ("SET MACS-NEW FRAME 60 -80 60 CM", ""),  # out of it
        ("SET MACS-NEW FRAME 93 0 70 CM", "BAY-2"),  # in another: it was put there
    ],
)
def test_where_a_thing_is_tells_which_seat_it_is_in(bench, sentence, seat):
    state(bench, sentence)

    assert bench.world.value("MACS-NEW.seat") == seat
    assert bench.world.get("MACS-NEW.grasp").validity is Validity.VALID


@pytest.mark.parametrize(
    ("sentence", "key", "value"),
    [
        ("SET MACS-NEW FRICTION 0.4", "friction", 0.4),
        ("SET MACS-NEW HANDLE-COLOUR RED", "handle_colour", "RED"),
        ("SET MACS-NEW SIZE 30 20 20 CM", "size", [0.3, 0.2, 0.2]),
    ],
)
def test_a_new_attribute_is_kept_as_it_is_stated(bench, sentence, key, value):
    state(bench, sentence)
    assert bench.world.value(f"MACS-NEW.{key}") == (pytest.approx(value) if isinstance(value, list) else value)
    script = bench.elaborate(sentence)  # and again, now that it is known
    assert all("no program uses it" in step.says for step in script.steps)  # the result states it
    assert not any(step.says for step in bench.elaborate("SET MACS-NEW MASS 2 KG").steps)
    state(bench, sentence)


# --- refused -----------------------------------------------------------------------------------------------


def test_a_name_nothing_bears_is_refused_with_the_nearest(bench):
    refusal = refused(bench, "SET MACS-NEU MASS 2.1 KG")

    assert refusal.reason is RefusalReason.NAME
    assert refusal.nearest[0] == "MACS-NEW"


def test_a_misspelt_attribute_is_no_new_one(bench):
    refusal = refused(bench, "SET MACS-NEW FRAEM 80 -80 60 CM")

    assert refusal.reason is RefusalReason.NAME
    assert refusal.nearest == ["FRAME"]
    assert {"FRAME", "MASS"} <= set(refusal.expected)


@pytest.mark.parametrize(
    ("sentence", "given"),
    [
        ("SET MACS-NEW FRAME 80 -80 CM", "2 numbers in m"),
        ("SET MACS-NEW FRAME 80 -80 60", "3 numbers without a unit"),
        ("SET MACS-NEW FRAME HERE", "a name without a unit"),
        ("SET MACS-NEW MASS 2 CM", "1 number in m"),
        ("SET MACS-NEW MASS 1 2 KG", "2 numbers in kg"),
    ],
)
def test_numbers_and_units_that_do_not_fit_are_refused_with_an_example(bench, sentence, given):
    refusal = refused(bench, sentence)

    assert refusal.reason is RefusalReason.SENTENCE
    assert refusal.where == sentence.split()[2]
    assert given in refusal.message  # wording: what the sentence has instead
    assert refusal.expected in (["71.5 12 28 CM"], ["2.1 KG"])


def test_what_is_found_out_is_not_reported(bench):
    refusal = refused(bench, "SET MACS-NEW HELD-BY RACK-2")

    assert refusal.reason is RefusalReason.NOT_ALLOWED
    assert "MACS-NEW" in in_one_line(refusal.clears)


@pytest.mark.parametrize("name", ["PEAK-FORCE", "PEAK-TORQUE", "WRENCH", "FORCE-OFFSET"])
def test_what_the_sensors_of_an_arm_measure_is_no_new_attribute(bench, name):
    assert refused(bench, f"SET MACS-NEW {name} 5").reason is RefusalReason.NOT_ALLOWED


def test_what_a_camera_measures_is_not_stated(bench):
    refusal = refused(bench, "SET MACS-NEW SIGHTING RED")

    assert refusal.reason is RefusalReason.NOT_ALLOWED
    assert [one.sentences for one in refusal.clears] == [["LOCATE MACS-NEW"]]


@pytest.mark.parametrize("sentence", ["SET MACS-NEW STATE LOOSE", "SET SATELLITE STATE TIGHT"])
def test_what_is_no_bolt_has_no_state(bench, sentence):
    run = bench.do(sentence)

    assert run.refusal is not None
    assert run.refusal.reason is RefusalReason.INFEASIBLE


def test_where_a_held_thing_is_tells_how_it_is_held(bench):
    bench.do(GRASP)
    bench.set_fact("MACS-NEW.grasp", bench.world.value("MACS-NEW.grasp"), Validity.SUSPECT)

    state(bench, "SET MACS-NEW FRAME 78 -80 60 CM")

    assert bench.world.value("MACS-NEW.held_by") == "RIGHT-ARM"
    assert bench.world.get("MACS-NEW.grasp").validity is Validity.VALID
    assert bench.do("LIFT MACS-NEW BY 20 CM").succeeded
    assert bench.world.value("MACS-NEW.frame")[:3] == pytest.approx([0.78, -0.80, 0.80], abs=0.001)


def test_a_held_thing_is_not_reported_to_be_far_from_its_hand(bench):
    bench.do(GRASP)

    refusal = refused(bench, "SET MACS-NEW FRAME 80 80 60 CM")

    assert (refusal.reason, refusal.where) == (RefusalReason.INFEASIBLE, "MACS-NEW.frame")
    assert refusal.cause == causes.NeedUnmet(need="object_free", by="RIGHT-ARM")


# --- attitudes and seats -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sentence", "place", "angles_deg"),
    [
        ("SET MACS-NEW FRAME 70 10 40 CM 5 -10 30 DEG", [0.70, 0.10, 0.40], [5, -10, 30]),
        ("SET MACS-NEW FRAME 0.7 0.1 0.4 M 0 0 0.5 RAD", [0.70, 0.10, 0.40], [0, 0, 28.647889]),
        ("SET MACS-NEW ATTITUDE 0 0 4 DEG", [0.80, -0.80, 0.60], [0, 0, 4]),
    ],
)
def test_an_attitude_is_stated_as_roll_pitch_and_yaw(bench, sentence, place, angles_deg):
    state(bench, sentence)

    wanted = geometry.from_rpy(place, [math.radians(n) for n in angles_deg])
    frame = bench.world.value("MACS-NEW.frame")
    assert geometry.distance(frame, wanted) < 1e-6
    assert geometry.angle(frame, wanted) < 1e-6


def test_the_step_says_what_was_stated_with_its_units(bench):
    script = bench.elaborate("SET MACS-NEW FRAME 80 77 60 CM 0 0 90 DEG")
    assert script.steps[0].label.endswith("MACS-NEW FRAME 0.8 0.77 0.6 m 0 0 1.5708 rad")


def test_a_module_that_is_turned_is_grasped_as_it_is(bench):
    state(bench, "SET MACS-NEW FRAME 78 -80 60 CM 0 0 12 DEG")

    assert bench.do("APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM").succeeded

    tcp = bench.model.arms["RIGHT-ARM"].fk(bench.world.value("RIGHT-ARM.joints"))
    axis = geometry.rotate(tcp, (0, 0, 1))
    assert math.atan2(axis[1], axis[0]) == pytest.approx(math.radians(12), abs=1e-4)


def test_an_object_is_stated_to_be_in_a_seat(bench):
    state(bench, "SET MACS-NEW FRAME 60 0 95 CM 0 0 30 DEG")
    state(bench, "SET MACS-NEW SEAT BAY-2")

    assert bench.world.value("MACS-NEW.seat") == "BAY-2"
    assert bench.world.value("MACS-NEW.frame") == pytest.approx([0.93, 0, 0.70, 0, 0, 0, 1], abs=1e-9)
    assert refused(bench, "SET MACS-NEW SEAT BAY-3").reason is RefusalReason.NAME
    assert refused(bench, "SET MACS-NEW SEAT RACK-2").cause == causes.NeedUnmet(need="seat_free", by="MACS-OLD")


def test_a_held_thing_gets_no_seat_and_the_advice_names_the_command_that_lets_it_go(bench):
    bench.do(GRASP)

    assert in_one_line(refused(bench, "SET MACS-NEW SEAT RACK-1").clears) == "RELEASE MACS-NEW"


def test_a_seat_that_is_stated_to_be_elsewhere_is_where_things_are_placed(bench):
    bench.do(GRASP)
    bench.do("LIFT MACS-NEW BY 15 CM")
    script = bench.elaborate("SET RACK-1 FRAME 78 -81 61 CM")
    assert script.writes == ["RACK-1"]  # what is in the hand does not go with it

    state(bench, "SET RACK-1 FRAME 78 -81 61 CM")
    assert bench.do("PLACE MACS-NEW ON RACK-1").succeeded

    placed = bench.world.value("MACS-NEW.frame")
    assert geometry.distance(placed, [0.78, -0.81, 0.61]) < 1e-3  # its catch holds it there
    assert bench.world.value("MACS-NEW.seat") == "RACK-1"


def test_a_seat_takes_along_what_sits_in_it(bench):
    script = bench.elaborate("SET RACK-1 FRAME 79 -80 60 CM 0 0 3 DEG")
    assert script.writes == script.resources == ["RACK-1", "MACS-NEW"]

    state(bench, "SET RACK-1 FRAME 79 -80 60 CM 0 0 3 DEG")

    wanted = geometry.from_rpy([0.79, -0.80, 0.60], [0, 0, math.radians(3)])
    assert geometry.distance(bench.world.value("MACS-NEW.frame"), wanted) < 1e-6
    assert geometry.angle(bench.world.value("MACS-NEW.frame"), wanted) < 1e-6


def test_a_seat_is_an_obstacle_where_it_is_stated_to_be(bench):
    assert bench.do("MOVE RIGHT-ARM TO RACK-1-FRONT").succeeded
    state(bench, "SET RACK-2 FRAME 45 -88 90 CM")
    assert refused(bench, "MOVE RIGHT-ARM BY 35 CM ALONG UP STRAIGHT-LINE").cause.body_b.startswith("RACK-2")


@pytest.mark.parametrize("sentence", ["SET RACK-1 MASS 3 KG", "SET RACK-1 SEAT RACK-2", "SET RACK-1 COLOUR RED"])
def test_of_a_seat_only_its_place_is_stated(bench, sentence):
    refusal = refused(bench, sentence)
    assert {"FRAME", "ATTITUDE", "ORIENTATION"} == set(refusal.expected)


def test_a_seat_beyond_the_cell_is_not_believed(bench):
    assert refused(bench, "SET RACK-1 FRAME 80 -80 900 CM").reason is RefusalReason.INFEASIBLE


def test_a_fixed_thing_stays_where_it_is(bench):
    assert refused(bench, "SET SATELLITE FRAME 80 -80 60 CM").reason is RefusalReason.STATE


def test_names_that_differ_in_a_number_are_names_of_two_facts(bench):
    """The second was refused: "did you mean SLOT-1?"."""
    state(bench, "SET MACS-OLD SLOT-1 5")
    state(bench, "SET MACS-OLD SLOT-2 6")
    assert [bench.world.value(f"MACS-OLD.slot_{n}") for n in (1, 2)] == [5, 6]
    assert refused(bench, "SET MACS-OLD SLTO-2 5").reason is RefusalReason.NAME
