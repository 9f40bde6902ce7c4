"""What to make of a report; and whole commands through the paper's loop, on perfect reports and on the real MCM."""

from __future__ import annotations

import math
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from rtc.protocol.advice import Alternative, sentences_of
from rtc.protocol.messages import Assessment, BoundStep, EndReport, Validity, WorldChange
from rtc.protocol.outcomes import ProgramError, Reflex, RefusalReason, StopReason
from rtc.protocol.sentence import Condition, Quantity
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line
from workers.analyzer import analyze
from workers.conditions import reflexes

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A GUARDED"


def bound_and_done(bench, sentence: str, n: int = 0) -> tuple[BoundStep, EndReport]:
    """Step n of the sentence, bound, and a report that it reached its goal."""
    script = bench.elaborate(sentence)
    bound = bench.bind(script, script.steps[n])
    assert isinstance(bound, BoundStep), bound
    return bound, bench.subsystem.perform(bound.primitive, bound)


def ended(report: EndReport, reason: StopReason, **fields) -> EndReport:
    return msgspec.structs.replace(report, reason=reason, **fields)


def judged(bench, bound: BoundStep, report: EndReport, **how) -> Assessment:
    made = bench.analyze(bound, report, **how)
    assert isinstance(made, Assessment), made
    return made


def change(made: Assessment, key: str):
    return next((c for c in made.changes if c.key == key), None)


def test_the_rate_of_creep_is_refused_in_a_program(bench):
    """The elaborator and the binder would not see it; all three read it in the cell."""
    bench.load("analyzer", "values: {creep_m_s: 0.0}")
    with pytest.raises(ProgramError, match=r"values\.creep_m_s: it is one of the cell's `numbers`"):
        analyze.compile(bench.programs["analyzer"])


# --- whole commands ----------------------------------------------------------------------------------------


def test_a_lift_that_leaves_the_module_in_its_slot_states_the_sentence_that_frees_it(bench):
    bench.do(GRASP)
    short = bench.do("LIFT MACS-NEW BY 10 CM WITH RIGHT-ARM").assessments[-1].remark
    advice = short.partition("free of it after: ")[2]
    assert advice == "LIFT MACS-NEW BY 5 CM WITH RIGHT-ARM"
    assert bench.do(advice).assessments[-1].remark == ""
    assert bench.do("MOVE RIGHT-ARM TO CLEAR-POINT-1").succeeded


def test_the_centring_grasp_from_first_line_to_last(either):
    run = either.do(GRASP)

    assert run.succeeded, run
    assert run.reasons == ["goal", "goal", "goal", "contact", "contact", "goal", "goal"]
    assert run.trims == []
    assert len(run.labels) == 9
    assert either.world.value("RIGHT-ARM.holding") == "MACS-NEW"
    assert either.world.value("MACS-NEW.held_by") == "RIGHT-ARM"
    assert either.world.value("RIGHT-ARM.hand_width") == pytest.approx(0.02, abs=0.001)


@pytest.mark.parametrize("aside_m", [0.008, -0.008])
def test_the_grasp_finds_out_where_the_object_really_is(either, aside_m):
    """The fingers feel both sides: the query is put right to what is true (R149)."""
    either.subsystem.displace("MACS-NEW", [0.0, aside_m, 0.0])

    run = either.do(GRASP)

    assert run.succeeded
    believed, true = either.world.value("MACS-NEW.frame"), either.subsystem.poses["MACS-NEW"]
    assert geometry.distance(believed, true) < 0.001
    grasp = either.world.value("MACS-NEW.grasp")
    tcp = either.model.arms["RIGHT-ARM"].fk(either.world.value("RIGHT-ARM.joints"))
    assert geometry.distance(geometry.compose(tcp, grasp), true) < 0.001


def test_take_carry_and_put_back(either):
    for sentence in (GRASP, "LIFT MACS-NEW BY 15 CM", "MOVE RIGHT-ARM TO CLEAR-POINT-1"):
        run = either.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.assessments)
    assert either.world.value("MACS-NEW.seat") == ""
    assert geometry.distance(either.world.value("MACS-NEW.frame"), [0.63, 0, 0.95]) < 0.001

    run = either.do("PLACE MACS-NEW ON RACK-1")

    assert run.succeeded, (run.refusal, run.assessments)
    assert either.world.value("MACS-NEW.seat") == "RACK-1"
    assert either.world.value("MACS-NEW.held_by") == ""
    assert either.world.value("RIGHT-ARM.holding") == ""
    assert geometry.distance(either.world.value("MACS-NEW.frame"), [0.80, -0.80, 0.60]) < 0.012


def test_a_module_that_a_lost_place_left_in_its_seat_is_believed_there_but_not_trusted(bench):
    for sentence in (GRASP, "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM", "PLACE MACS-NEW ON RACK-1", GRASP):
        assert bench.do(sentence).succeeded, sentence
    unknown = Validity.SUSPECT
    in_the_hand = [  # the controller died during the tug: the module is in the seat, and was not let go of
        WorldChange(key="MACS-NEW.seat", value="", validity=unknown),
        *(
            WorldChange(key=f"MACS-NEW.{name}", keep_value=True, validity=unknown)
            for name in ("frame", "grasp", "held_by")
        ),
        *(WorldChange(key=f"RIGHT-ARM.{name}", keep_value=True, validity=unknown) for name in ("joints", "holding")),
    ]
    bench.world = bench.world.overlay(in_the_hand, source="C-5/9")

    assert bench.do("RELEASE MACS-NEW").succeeded

    seat = bench.world.get("MACS-NEW.seat")
    assert (seat.value, seat.validity) == ("RACK-1", Validity.SUSPECT)
    assert bench.world.value("MACS-NEW.held_by") == ""


def test_let_go_and_take_again(either):
    either.do(GRASP)

    released = either.do("RELEASE MACS-NEW")
    again = either.do(GRASP)

    assert released.succeeded
    assert again.succeeded


# --- trims -------------------------------------------------------------------------------------------------


def test_nothing_felt_is_mended_once_and_then_reported(either):
    """Without cameras: end-point reached, nothing felt; trim 2 starts over, 15 mm farther on. The second time it is
    a failure, and the hand is drawn back out of where the handle is believed to be."""
    either.without_cameras()
    either.subsystem.displace("MACS-NEW", [0.0, 0.0255, 0.0])  # from 26 mm on a finger lands on it

    run = either.do(GRASP)

    assert run.refusal is None
    assert run.trims == [2, 3]
    assert run.failure.reason is StopReason.NO_CONTACT
    assert "SET MACS-NEW FRAME 80 -78.5 60 CM" in in_one_line(run.failure.clears)
    assert run.labels[-2:] == ["open again", "back off from HANDLE-A"]
    assert either.world.get("MACS-NEW.frame").validity is Validity.SUSPECT
    assert either.elaborate(GRASP).reason is RefusalReason.SUSPECT


def test_the_first_failure_is_mended_and_the_second_try_succeeds(bench):
    """R77: the second search begins where the first has ended, and so finds what lies beyond."""
    bench.without_cameras()
    bench.subsystem.displace("MACS-NEW", [0.0, 0.020, 0.0])

    run = bench.do(GRASP)

    assert run.succeeded
    assert run.trims == [2]
    assert bench.world.get("MACS-NEW.frame").validity is Validity.VALID
    assert geometry.distance(bench.world.value("MACS-NEW.frame"), bench.subsystem.poses["MACS-NEW"]) < 0.001


def test_the_side_that_was_felt_tells_where_to_feel_the_other(bench):
    """Off to the other side the first search meets the handle early; the second goes from there, and needs no trim."""
    bench.subsystem.displace("MACS-NEW", [0.0, -0.025, 0.0])

    run = bench.do(GRASP)

    assert run.succeeded
    assert run.trims == []
    assert geometry.distance(bench.world.value("MACS-NEW.frame"), bench.subsystem.poses["MACS-NEW"]) < 0.001


@pytest.mark.parametrize(("closes", "succeeds"), [([0.0], True), ([0.0, 0.0], False)])
def test_a_bad_first_close_is_repeated_once(bench, closes, succeeds):
    """R119."""
    bench.load("elaborator", "decision_tree: [{verb: GRASP, script: grasp-centering, enabled: false}]")
    bench.do("MOVE RIGHT-ARM TO RACK-1-FRONT")
    bench.subsystem.closes = closes

    run = bench.do(GRASP)

    assert run.trims == [1]
    assert run.succeeded is succeeds
    if not succeeds:
        assert run.failure.reason is StopReason.NO_CONTACT
        assert bench.world.value("RIGHT-ARM.holding") == ""


def test_a_failing_action_fails_at_once(bench):
    """R78."""
    bench.subsystem.instead["C-1.1"] = StopReason.FORCE_LIMIT

    run = bench.do("MOVE RIGHT-ARM TO BAY-2-FRONT")

    assert [a.verdict for a in run.assessments] == ["abort"]
    assert run.assessments[0].clears


def test_a_trim_is_used_once_for_a_step_and_only_where_it_fits(bench):
    script = bench.elaborate(GRASP)
    bench.do("APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM")
    bound = bench.bind(script, script.steps[4])
    report = bench.subsystem.perform(bound.primitive, bound)

    assert judged(bench, bound, ended(report, StopReason.FORCE_LIMIT)).trim == 2
    assert judged(bench, bound, ended(report, StopReason.FORCE_LIMIT), used=[2]).trim == 3
    assert judged(bench, bound, ended(report, StopReason.FORCE_LIMIT), used=[2, 3]).verdict == "abort"
    for reason in (StopReason.JOINT_LIMIT, StopReason.COLLISION, StopReason.TIMEOUT, StopReason.HALT):
        assert judged(bench, bound, ended(report, reason)).verdict == "abort", reason


# --- the world after it ------------------------------------------------------------------------------------


def test_a_halt_in_free_motion_leaves_the_object_trusted(bench):
    bound, report = bound_and_done(bench, "APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM")
    halfway = bound.primitive.trajectory.positions[20]

    made = judged(bench, bound, ended(report, StopReason.HALT, joints=halfway), closing=True)

    assert made.verdict == "abort"
    assert change(made, "RIGHT-ARM.joints").value == halfway
    assert change(made, "RIGHT-ARM.joints").validity is Validity.VALID
    assert change(made, "MACS-NEW.frame") is None
    assert not made.remark


def test_after_a_halt_while_carrying_the_next_command_works_at_once(bench):
    bench.without_cameras()
    bench.do(GRASP)
    bench.do("LIFT MACS-NEW BY 15 CM")
    bound, report = bound_and_done(bench, "MOVE RIGHT-ARM TO CLEAR-POINT-1")

    made = judged(bench, bound, ended(report, StopReason.HALT), closing=True)
    bench.world = bench.world.overlay(made.changes)

    assert made.remark == "MACS-NEW may swing for 0.2 s more"
    assert bench.world.get("MACS-NEW.frame").validity is Validity.SUSPECT
    assert bench.do("RETRACT RIGHT-ARM BY 2 CM").succeeded
    assert bench.world.get("MACS-NEW.frame").validity is Validity.SUSPECT  # moving it proves nothing
    assert bench.elaborate("MOVE RIGHT-ARM TO BAY-2-FRONT").reason is RefusalReason.SUSPECT
    assert bench.elaborate("PLACE MACS-NEW ON RACK-1").reason is RefusalReason.SUSPECT
    assert bench.do("RELEASE MACS-NEW VIA FREE-DRIFT").succeeded
    assert bench.do("STOW RIGHT-ARM").succeeded


@pytest.mark.parametrize(("took_s", "late"), [(0.26, False), (0.60, True)])
def test_an_arm_that_is_at_its_goal_already_may_settle_there(bench, took_s, late):
    """An offset from the path fades out in 0.25 s, however short the path is: STOW of a stowed arm warned each time."""
    assert bench.do("STOW RIGHT-ARM").succeeded
    bound, report = bound_and_done(bench, "STOW RIGHT-ARM")
    made = judged(bench, bound, ended(report, StopReason.GOAL, duration_s=took_s))
    assert bool(made.drift) is late


def test_a_force_in_a_carry_may_come_from_the_load(bench):
    """A module of 1.5 times the stated mass was stopped so, with nothing in its way."""
    bench.without_cameras()
    bench.do(GRASP)
    bench.do("LIFT MACS-NEW BY 15 CM")
    bound, report = bound_and_done(bench, "MOVE RIGHT-ARM TO CLEAR-POINT-1")
    laden = judged(bench, bound, ended(report, StopReason.FORCE_LIMIT))
    assert "or MACS-NEW is heavier" in laden.message  # wording: a guess for a person
    assert "correct the mass of MACS-NEW" in in_one_line(laden.clears)

    bound, report = bound_and_done(bench, "MOVE LEFT-ARM TO CLEAR-POINT-1")
    empty = judged(bench, bound, ended(report, StopReason.FORCE_LIMIT))
    assert "heavier" not in empty.message + in_one_line(empty.clears)  # wording


@pytest.mark.parametrize(("peak_n", "suspect"), [(0.4, False), (7.0, True)])
def test_a_halt_while_feeling_makes_suspect_what_was_touched(bench, peak_n, suspect):
    """R151. Nothing was touched when nothing was felt: the next grasp works at once."""
    script = bench.elaborate(GRASP)
    bench.do("APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM")
    bound = bench.bind(script, script.steps[4])
    report = bench.subsystem.perform(bound.primitive, bound)

    made = judged(bench, bound, ended(report, StopReason.HALT, peak_force_n=peak_n), closing=True)
    bench.world = bench.world.overlay(made.changes)

    assert (change(made, "MACS-NEW.frame") is not None) is suspect
    assert bench.world.get("MACS-NEW.frame").validity is (Validity.SUSPECT if suspect else Validity.VALID)
    assert bench.world.value("MACS-NEW.frame") is not None


def test_fingers_halted_while_they_press_do_hold(bench):
    """Otherwise an arm could drag along an object that it is not known to hold."""
    bench.without_cameras()
    script = bench.elaborate(GRASP)
    bench.do("MOVE RIGHT-ARM TO-GRASP-POINT-OF MACS-NEW")
    bound = bench.bind(script, script.steps[-1])
    report = bench.subsystem.perform(bound.primitive, bound)

    made = judged(bench, bound, ended(report, StopReason.HALT, hand_width_m=0.02, hand_force_n=12.0), closing=True)

    assert change(made, "RIGHT-ARM.holding").value == "MACS-NEW"
    assert change(made, "MACS-NEW.grasp").validity is Validity.SUSPECT

    bench.world = bench.world.overlay(made.changes)
    refusal = bench.elaborate("LIFT MACS-NEW BY 5 CM")
    assert (refusal.reason, in_one_line(refusal.clears)) == (RefusalReason.SUSPECT, "VERIFY MACS-NEW AT RIGHT-ARM")


def test_a_lift_that_closes_on_nothing_finds_out(bench):
    assert bench.do(GRASP).succeeded
    bench.subsystem.closes = [0.001]  # it was taken away meanwhile

    run = bench.do("LIFT MACS-NEW BY 5 CM")

    assert run.labels == ["hold MACS-NEW tight"]
    assert run.reasons == ["no_contact"]
    assert run.reports[-1].hand_width_m == 0.001
    assert bench.world.value("RIGHT-ARM.holding") == ""
    assert bench.world.get("MACS-NEW.frame").validity is Validity.INVALID


def test_a_lost_object_is_held_no_more(bench):
    bench.do(GRASP)
    bound, report = bound_and_done(bench, "LIFT MACS-NEW BY 15 CM", 1)

    made = judged(bench, bound, ended(report, StopReason.OBJECT_LOST, hand_width_m=0.0))

    assert change(made, "RIGHT-ARM.holding").value == ""
    assert change(made, "MACS-NEW.frame").validity is Validity.INVALID
    assert made.verdict == "abort"


def test_a_reflex_that_opened_the_hand_has_let_go(bench):
    bench.do(GRASP)
    bound, report = bound_and_done(bench, "LIFT MACS-NEW UNLESS FORCE EXCEEDS 9 N THEN RELEASE", 1)

    tripped = {"hand_width_m": 0.08, "measured": 9.4, "limit": 9.0, "reflex": Reflex.RELEASE}
    made = judged(bench, bound, ended(report, StopReason.FORCE_LIMIT, **tripped))

    assert change(made, "MACS-NEW.held_by").value == ""
    words = "stopped at 9.4 N as asked: UNLESS FORCE EXCEEDS 9 N THEN RELEASE; opened the hand to 80 mm"
    assert words in made.message  # wording: figures with their units


def test_fingers_that_are_a_little_wider_may_hold_a_tilted_object(bench):
    """Given a carried object that turns in the hand, then the arm is not believed to be empty."""
    bench.do(GRASP)
    bound, report = bound_and_done(bench, "LIFT MACS-NEW", 1)

    made = judged(bench, bound, ended(report, StopReason.TIMEOUT, hand_width_m=report.hand_width_m + 0.007))

    assert not any(one.key.endswith((".holding", ".held_by")) for one in made.changes)
    assert change(made, "MACS-NEW.grasp").validity is Validity.SUSPECT
    assert "VERIFY MACS-NEW AT RIGHT-ARM" in in_one_line(made.clears)


def _felt(bench, sentence: str, reason: StopReason, limit: float, back_m: float = 0.0) -> Assessment:
    bound, report = bound_and_done(bench, sentence)
    back = geometry.compose(report.tcp_pose, (0.0, 0.0, -back_m, 0.0, 0.0, 0.0, 1.0)).tolist()
    reflex = Reflex.BACK_OFF if back_m else Reflex.STOP
    figures = {"measured": 47.4, "limit": limit, "trip_pose": report.tcp_pose, "tcp_pose": back, "reflex": reflex}
    return judged(bench, bound, ended(report, reason, **figures))


FORWARD = "MOVE RIGHT-ARM BY 5 CM ALONG TOOL-Z UNLESS CONTACT"


def test_a_stop_that_was_asked_for_reads_as_such(bench):
    made = _felt(bench, f"{FORWARD} THEN STOP", StopReason.CONTACT, 5.0)
    assert (made.verdict, made.reason) == ("abort", StopReason.CONTACT)  # the goal is not reached
    assert made.message.endswith("stopped at 47.4 N as asked: UNLESS CONTACT THEN STOP")  # wording
    assert "in the way" not in in_one_line(made.clears)


def test_what_was_done_after_the_stop_is_reported(bench):
    made = _felt(bench, f"{FORWARD} THEN BACK-OFF BY 2 CM", StopReason.CONTACT, 5.0, 0.02)
    assert made.message.endswith("as asked: UNLESS CONTACT THEN BACK-OFF; backed off by 2.0 cm")  # wording


def test_a_back_off_from_a_turn_reports_the_angle():
    turned = {"trip_pose": [0, 0, 0, 0, 0, 0, 1.0], "tcp_pose": [0, 0, 0, 0, 0, math.sin(0.1), math.cos(0.1)]}
    how = {"reason": StopReason.CONTACT, "reflex": Reflex.BACK_OFF, "at_s": 1.0, "duration_s": 1.0}
    report = EndReport(primitive="C-1.1", performer="LEFT-ARM", **how, **turned)
    assert reflexes.describe_action(report) == "backed off by 0.0 cm and 11.5 deg"


def test_figures_of_a_condition_have_the_units_of_a_sentence():
    lengths = ((0.08, "m", "80 MM"), (1.04, "m", "1040 MM"))
    for written, si, shown in ((0.174532925, "rad", "10 DEG"), *lengths, (5.0, "N", "5 N")):
        condition = Condition(measure="TURN", bound="above", quantity=Quantity(written, si))
        assert condition.sentence == f"TURN EXCEEDS {shown}"
        assert condition.measured_in_words(written) == shown


def test_the_reason_is_the_one_that_won_and_what_was_done_is_reported_beside_it(bench):
    made = _felt(bench, f"{FORWARD} THEN BACK-OFF BY 2 CM", StopReason.FORCE_LIMIT, 40.0, 0.02)
    assert made.reason is StopReason.FORCE_LIMIT
    words = "47.4 N where 40 N is the limit; perhaps something is in the way; backed off by 2.0 cm"
    assert made.message.endswith(words)  # wording


@pytest.mark.parametrize(("limit", "advised"), [(3.0, True), (30.0, False)])
def test_a_force_limit_of_the_sentence_is_named_if_it_ended_the_step(bench, limit, advised):
    sentence = "MOVE RIGHT-ARM BY 5 CM ALONG TOOL-Z MAINTAIN FORCE-LIMIT 3 N"
    made = _felt(bench, sentence, StopReason.FORCE_LIMIT, limit)
    assert ("FORCE-LIMIT above 3 N" in in_one_line(made.clears)) is advised


def test_without_a_report_of_the_arm_its_joints_are_suspect(bench):
    bound, report = bound_and_done(bench, "STOW RIGHT-ARM")

    made = judged(bench, bound, ended(report, StopReason.SUBSYSTEM_LOST, joints=[], tcp_pose=[]))

    joints = change(made, "RIGHT-ARM.joints")
    assert (joints.validity, joints.keep_value) == (Validity.SUSPECT, True)


def test_what_the_hand_holds_is_suspect_with_it_without_a_report(bench):
    assert bench.do(GRASP).succeeded
    bound, report = bound_and_done(bench, "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM")
    made = judged(bench, bound, ended(report, StopReason.SUBSYSTEM_LOST, joints=[], tcp_pose=[]), closing=True)
    bench.world = bench.world.overlay(made.changes, source="C-2/9")
    arm = [f"RIGHT-ARM.{attribute}" for attribute in ("joints", "hand_width", "holding")]
    module = [f"MACS-NEW.{attribute}" for attribute in ("frame", "grasp", "held_by", "seat")]
    assert {bench.world.get(key).validity for key in (*arm, *module)} == {Validity.SUSPECT}
    assert bench.world.value("MACS-NEW.held_by") == "RIGHT-ARM"


def test_a_refused_primitive_tells_where_the_arm_really_is(bench):
    """It did not begin because the arm is elsewhere: the report puts the fact right, the next command works."""
    bound, report = bound_and_done(bench, "STOW RIGHT-ARM")
    true = [0.3, 2.3, -2.6, 0.0, 0.2, 0.0]

    made = judged(bench, bound, ended(report, StopReason.REFUSED, joints=true, message="does not start where it is"))

    assert change(made, "RIGHT-ARM.joints").value == true
    assert (made.verdict, made.reason) == ("abort", StopReason.REFUSED)


@pytest.mark.parametrize("reason", [StopReason.FORCE_LIMIT, StopReason.TORQUE_LIMIT, StopReason.TIMEOUT])
def test_an_end_without_figures_has_its_own_words(bench, reason):
    """As of a forced end, or of a subsystem of a user: not by the words of figures that are not there."""
    bound, report = bound_and_done(bench, "STOW RIGHT-ARM")
    bare = ended(report, reason, measured=None, limit=None, message="as forced")
    assert judged(bench, bound, bare).message.endswith("as forced")  # wording


def test_a_goal_that_is_not_there_is_no_success(bench):
    """R151: the post-condition is checked after every primitive."""
    bound, report = bound_and_done(bench, "MOVE RIGHT-ARM TO BAY-2-FRONT")
    aside = geometry.translate(report.tcp_pose, [0.0, 0.01, 0.0]).tolist()

    made = judged(bench, bound, ended(report, StopReason.GOAL, tcp_pose=aside))

    assert made.verdict == "abort"
    assert made.reason is StopReason.GOAL


def test_a_seat_touched_too_early_is_not_seated(bench):
    bench.do(GRASP)
    bench.do("LIFT MACS-NEW BY 15 CM")
    script = bench.elaborate("PLACE MACS-NEW ON RACK-1")
    verdicts = []
    for before, step in pairwise(script.steps[:3]):
        there = bench.bind(script, before)
        report = bench.subsystem.perform(there.primitive, there)
        bench.world = bench.world.overlay(judged(bench, there, report).changes)
        made = judged(bench, bench.bind(script, step), ended(report, StopReason.CONTACT))
        verdicts.append((made.verdict, made.reason))

    assert verdicts == [("abort", StopReason.CONTACT), ("abort", StopReason.COLLISION)]


def test_measured_values_are_kept_where_they_were_felt(bench):
    script = bench.elaborate(GRASP)
    bench.do("APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM")
    bound = bench.bind(script, script.steps[4])
    report = bench.subsystem.perform(bound.primitive, bound)
    felt = geometry.translate(report.tcp_pose, [0.0, 0.0005, 0.0]).tolist()

    made = judged(bench, bound, ended(report, StopReason.CONTACT, trip_pose=felt))

    assert made.keep["GP1"].pose == felt
    assert made.keep["GP1"].frame is None


@pytest.mark.parametrize("n", [0, 2, 3, 4, 8])
def test_every_reason_has_an_answer_for_every_step(bench, n):
    """R84: nothing that can be reported is without a response."""
    script = bench.elaborate(GRASP)
    bench.do("APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM")
    bound = bench.bind(script, script.steps[n])
    report = bench.subsystem.perform(bound.primitive, bound)

    for reason in StopReason:
        made = judged(bench, bound, ended(report, reason))

        assert made.verdict in ("continue", "trim", "abort"), reason
        assert made.message, reason  # wording: there is one
        assert len({c.key for c in made.changes}) == len(made.changes), reason


# --- does the hand still hold it? --------------------------------------------------------------------------


def test_what_a_halt_has_put_in_doubt_is_trusted_again_when_the_fingers_feel_it(either):
    either.without_cameras()
    either.do(GRASP)
    for key in ("MACS-NEW.grasp", "MACS-NEW.frame", "MACS-NEW.held_by", "RIGHT-ARM.holding"):
        either.set_fact(key, either.world.value(key), Validity.SUSPECT)
    refusal = either.elaborate("PLACE MACS-NEW ON RACK-1")
    assert refusal.reason is RefusalReason.SUSPECT

    run = either.do(refusal.clears[0].sentences[0])

    assert run.succeeded, (run.refusal, run.assessments)
    assert all(fact.validity is Validity.VALID for fact in either.world.facts.values())
    for sentence in ("LIFT MACS-NEW BY 15 CM", "PLACE MACS-NEW ON RACK-1"):
        assert either.do(sentence).succeeded


def test_fingers_that_close_on_nothing_have_lost_it(bench):
    bench.without_cameras()
    bench.do(GRASP)
    bound, report = bound_and_done(bench, "VERIFY MACS-NEW AT RIGHT-ARM")

    made = judged(bench, bound, msgspec.structs.replace(report, hand_width_m=0.0, hand_force_n=0.0))

    assert (made.verdict, made.reason) == ("abort", StopReason.NO_CONTACT)
    assert change(made, "RIGHT-ARM.holding").value == ""
    assert change(made, "MACS-NEW.held_by").value == ""
    assert change(made, "MACS-NEW.frame").validity is Validity.INVALID
    assert "SET MACS-NEW FRAME" in in_one_line(made.clears)


# --- what would clear it -----------------------------------------------------------------------------------


def test_advice_is_for_what_is_suspect_now_and_in_order(bench):
    """Look first; then what makes the thing in the hand trusted again; then again."""
    bench.do(GRASP)
    bench.do("LIFT MACS-NEW BY 15 CM")
    bound, report = bound_and_done(bench, "MOVE RIGHT-ARM TO CLEAR-POINT-1")

    made = judged(bench, bound, ended(report, StopReason.TIMEOUT))

    (advised,) = made.clears
    assert (advised.sentences, advised.again) == (["VERIFY MACS-NEW AT RIGHT-ARM"], True)


@pytest.mark.parametrize(
    ("reason", "measured", "limit", "figures"),
    [
        (StopReason.FORCE_LIMIT, 90.0, 80.0, "90 N where 80 is the limit"),
        (StopReason.TORQUE_LIMIT, 1240.0, 1200.0, "1240 N.m where 1200 is the limit"),
        (StopReason.FORCE_LIMIT, 0.0604, 0.06, "60 mm behind its path"),
        (StopReason.TORQUE_LIMIT, 17.0, 16.0, "17 N.m where 16 is the limit"),
    ],
)
def test_a_jam_has_its_unit(bench, reason, measured, limit, figures):
    """A force, a torque, or the distance of the hand behind its path ends the way into a seat."""
    bound, report = bound_and_done(bench, "STOW RIGHT-ARM")
    into = msgspec.structs.replace(bound.evaluation, step=msgspec.structs.replace(bound.evaluation.step, stop="insert"))
    bound = msgspec.structs.replace(bound, evaluation=into)
    wrench = [90.0, 0.0, 0.0, 0.0, 0.0, 0.0]

    made = judged(bench, bound, ended(report, reason, measured=measured, limit=limit, trip_wrench=wrench))

    assert figures in made.message  # wording: units


def test_a_motion_that_pressed_until_its_time_ended_reports_how_far_it_came_and_with_what_force(bench):
    """More time would not help it: a jammed seat holds the module with any force."""
    bench.do(GRASP)
    bench.do("LIFT MACS-NEW BY 15 CM")
    bound, report = bound_and_done(bench, "MOVE RIGHT-ARM TO CLEAR-POINT-1 MAINTAIN TIME-LIMIT 20 SEC")
    short = geometry.translate(report.tcp_pose, [-0.04, 0.0, 0.0]).tolist()
    late = ended(report, StopReason.TIMEOUT, tcp_pose=short, trip_wrench=[16.0, 0.0, 0.0, 0.0, 0.0, 0.0])

    pressed, free = judged(bench, bound, late), judged(bench, bound, ended(late, StopReason.TIMEOUT, trip_wrench=None))

    assert "40 mm from the end of its path, and pressed with 16 N" in pressed.message  # wording: figures
    verify, back = pressed.clears[0].sentences
    assert verify == "VERIFY MACS-NEW AT RIGHT-ARM"
    assert back.startswith("MOVE RIGHT-ARM BY ")
    assert free.message.endswith("40 mm from the end of its path")  # wording
    assert "a TIME-LIMIT above 20 S" in free.clears[0].words


@pytest.mark.parametrize(
    ("reason", "force"),
    [(StopReason.HALT, [0.0, 0.0, -8.0]), (StopReason.JOINT_LIMIT, [0.0, 0.0, -8.0]), (StopReason.HALT, [-8.0, 0, 0])],
)
def test_a_laden_arm_that_pressed_at_its_stop_is_sent_back_the_way_it_came(bench, reason, force):
    """The force may point aside: the object turns in the hand."""
    assert bench.do(GRASP).succeeded
    assert bench.do("LIFT MACS-NEW BY 15 CM").succeeded
    bound, report = bound_and_done(bench, "MOVE RIGHT-ARM BY 8 CM ALONG UP")
    in_tool = geometry.rotate(geometry.inverse(report.tcp_pose), force).tolist()
    pressed = ended(report, reason, trip_pose=report.tcp_pose, trip_wrench=[*in_tool, 0.0, 0.0, 0.0])

    assert "MOVE RIGHT-ARM BY -5 CM ALONG Z" in in_one_line(judged(bench, bound, pressed).clears)
    free = ended(pressed, reason, trip_wrench=[0.0] * 6)
    assert "BY -5 CM" not in in_one_line(judged(bench, bound, free).clears)


def test_a_laden_arm_is_sent_back_along_a_line_after_its_hand_was_sensed(bench):
    """Before, the line is refused: the grasp is suspect, and no camera helps."""
    bench.without_cameras()
    assert bench.do(GRASP).succeeded
    assert bench.do("LIFT MACS-NEW BY 15 CM").succeeded
    bound, report = bound_and_done(bench, "MOVE RIGHT-ARM BY 8 CM ALONG UP")
    made = judged(bench, bound, pressed_down(report, StopReason.HALT))
    first, line = made.clears[0].sentences
    assert line == "MOVE RIGHT-ARM BY -5 CM ALONG Z"
    bench.world = bench.world.overlay(made.changes)
    assert bench.elaborate(line).clears[0].sentences == [first]
    for sentence in (first, line):
        assert bench.do(sentence).succeeded, sentence


def pressed_down(report: EndReport, reason: StopReason, **fields) -> EndReport:
    in_tool = geometry.rotate(geometry.inverse(report.tcp_pose), [0.0, 0.0, -25.0]).tolist()
    return ended(report, reason, trip_pose=report.tcp_pose, trip_wrench=[*in_tool, 0.0, 0.0, 0.0], **fields)


WHILE_LIFTING = [StopReason.HALT, StopReason.FORCE_LIMIT, StopReason.CONTACT, StopReason.TIMEOUT]


@pytest.mark.parametrize("reason", WHILE_LIFTING)
def test_an_arm_that_pressed_above_the_slot_is_sent_back_along_its_tool(bench, reason):
    assert bench.do(GRASP).succeeded
    bound, report = bound_and_done(bench, "LIFT MACS-NEW BY 14 CM", n=1)
    made = judged(bench, bound, pressed_down(report, reason))
    assert made.clears[0].sentences[0] == "RETRACT RIGHT-ARM"
    bench.world = bench.world.overlay(made.changes)
    assert bench.elaborate("RETRACT RIGHT-ARM").steps


@pytest.mark.parametrize("reason", WHILE_LIFTING)
@pytest.mark.parametrize(("lifted", "back"), [("8 CM", "-5 CM"), ("2.6 CM", "-1.6 CM")])
def test_an_arm_that_pressed_in_a_slot_is_sent_back_into_it(bench, reason, lifted, back):
    """Back along the tool would be the same way, or against the slot. It ends before the bottom of the seat."""
    bench.without_cameras()
    assert bench.do(GRASP).succeeded
    bound, report = bound_and_done(bench, f"LIFT MACS-NEW BY {lifted}", n=1)
    made = judged(bench, bound, pressed_down(report, reason))
    first, then, *_ = made.clears[0].sentences
    assert first == "VERIFY MACS-NEW AT RIGHT-ARM"
    assert then == f"LIFT MACS-NEW BY {back} WITH RIGHT-ARM"
    bench.world = bench.world.overlay(made.changes)
    height_m = bench.world.value("MACS-NEW.frame")[2]
    for sentence in (first, then):
        assert bench.do(sentence).succeeded, sentence
    assert bench.world.value("MACS-NEW.frame")[2] == pytest.approx(height_m + 0.01 * float(back.split()[0]), abs=1e-3)


@pytest.mark.parametrize("reason", WHILE_LIFTING)
def test_a_hand_lets_go_of_what_is_near_the_bottom_of_its_slot(bench, reason):
    """Down, the bottom would stop it, and up it was stopped."""
    assert bench.do(GRASP).succeeded
    bound, report = bound_and_done(bench, "LIFT MACS-NEW BY 1.2 CM", n=1)
    made = judged(bench, bound, pressed_down(report, reason))
    assert made.clears[0].sentences == ["RELEASE MACS-NEW WITH RIGHT-ARM", "LOCATE MACS-NEW"]
    assert (made.clears[0].instead, made.clears[0].again) == (True, False)
    assert not any(" BY -" in sentence for sentence in sentences_of(made.clears))
    bench.world = bench.world.overlay(made.changes)
    for sentence in (*made.clears[0].sentences, "STOW RIGHT-ARM"):
        assert bench.do(sentence).succeeded, sentence


@pytest.mark.parametrize("reason", [StopReason.HALT, StopReason.FORCE_LIMIT, StopReason.CONTACT])
def test_what_was_pressed_down_in_its_slot_is_lifted_and_not_pressed_again(bench, reason):
    assert bench.do(GRASP).succeeded
    assert bench.do("LIFT MACS-NEW BY 6 CM").succeeded
    bound, report = bound_and_done(bench, "LIFT MACS-NEW BY -4 CM", n=1)
    ways = bound.primitive.trajectory.positions
    halfway = list(ways[len(ways) // 2])
    there = bench.model.arms["RIGHT-ARM"].fk(halfway).tolist()
    stopped = msgspec.structs.replace(report, joints=halfway, tcp_pose=there)
    made = judged(bench, bound, pressed_down(stopped, reason))
    assert "LIFT MACS-NEW BY 2 CM WITH RIGHT-ARM" in sentences_of(made.clears)
    assert not any(" BY -" in sentence for sentence in sentences_of(made.clears))


def test_a_hand_is_sent_back_no_further_than_it_came(bench):
    bound, report = bound_and_done(bench, "MOVE RIGHT-ARM BY 2 CM ALONG UP")
    assert "MOVE RIGHT-ARM BY -2 CM ALONG Z" in in_one_line(
        judged(bench, bound, pressed_down(report, StopReason.HALT)).clears
    )


def test_an_arm_whose_retreat_is_blocked_is_sent_another_way(bench):
    bound, report = bound_and_done(bench, "RETRACT RIGHT-ARM BY 5 CM")
    made = judged(bench, bound, pressed_down(report, StopReason.FORCE_LIMIT))
    assert made.clears[0].sentences[0].startswith("MOVE RIGHT-ARM BY ")
    assert not any(text.startswith("RETRACT") for text in sentences_of(made.clears))


@pytest.mark.parametrize("reason", [StopReason.FORCE_LIMIT, StopReason.CONTACT, StopReason.COLLISION])
def test_a_motion_of_the_joints_that_met_something_is_left_as_the_hand_came(bench, reason):
    """RETRACT was advised: back along the tool. A box was behind the fingers there, and held the arm with 70 N."""
    assert bench.do("MOVE RIGHT-ARM TO BAY-2-FRONT").succeeded
    bound, report = bound_and_done(bench, "STOW RIGHT-ARM")
    start, goal = (np.array(bound.primitive.trajectory.positions[n]) for n in (0, -1))
    joints, before = (0.5 * (start + goal)).tolist(), 0.51 * start + 0.49 * goal
    arm = bench.model.arms["RIGHT-ARM"]
    there = arm.fk(joints)
    back = arm.fk(before)[:3] - there[:3]
    tool = geometry.rotate(there, [0.0, 0.0, 1.0])
    assert float(back @ tool) > -0.7 * float(np.linalg.norm(back))  # RETRACT leads elsewhere
    met = ended(report, reason, joints=joints, tcp_pose=there.tolist(), trip_pose=there.tolist())
    aside = geometry.rotate(geometry.inverse(there), [0.0, 0.0, -60.0]).tolist()

    (line, *_) = sentences_of(judged(bench, bound, ended(met, reason, trip_wrench=[*aside, 0.0, 0.0, 0.0])).clears)
    _, _, _, by_cm, _, _, axis = line.split()
    n = "XYZ".index(axis)
    assert n == int(np.abs(back).argmax())
    assert float(by_cm) * back[n] > 0.0

    free = judged(bench, bound, ended(met, reason, trip_wrench=[0.0] * 6))
    assert sentences_of(free.clears)[0] == "RETRACT RIGHT-ARM"


@pytest.mark.parametrize(("off_m", "verdict"), [(0.010, "continue"), (0.020, "abort")])
def test_what_an_arm_leaves_may_push_it_aside(bench, off_m, verdict):
    bound, report = bound_and_done(bench, "RETRACT RIGHT-ARM")
    aside = geometry.translate(report.tcp_pose, [off_m, 0.0, 0.0]).tolist()
    assert judged(bench, bound, ended(report, StopReason.GOAL, tcp_pose=aside)).verdict == verdict


def test_a_grip_above_the_asked_one_is_not_taken_for_an_obstacle(bench):
    """Fingers at 45 N where GRIP-FORCE 25 N allows 35.5 N ended a motion on which nothing was in the way."""
    bench.without_cameras()
    assert bench.do(GRASP).succeeded
    bound, report = bound_and_done(bench, "LIFT MACS-NEW BY 15 CM MAINTAIN GRIP-FORCE 25 N GUARDED", 1)
    made = judged(bench, bound, ended(report, StopReason.FORCE_LIMIT, measured=45.0, limit=1.3 * 25.0 + 3.0))
    assert "press with 45 N; GRIP-FORCE 25 N allows 35.5 N" in made.message  # wording
    assert "in the way" not in made.message + in_one_line(made.clears)  # wording
    assert "a GRIP-FORCE above 25 N" in in_one_line(made.clears)
    at_the_wrist = judged(bench, bound, ended(report, StopReason.FORCE_LIMIT, measured=45.0, limit=20.0))
    assert "GRIP-FORCE" not in at_the_wrist.message + in_one_line(at_the_wrist.clears)  # wording


def test_a_stop_that_was_asked_for_names_the_way_out_of_what_the_arm_presses_on(bench):
    bound, report = bound_and_done(bench, "MOVE RIGHT-ARM BY 8 CM ALONG UP UNLESS FORCE EXCEEDS 20 N THEN STOP")
    stopped = pressed_down(report, StopReason.FORCE_LIMIT, measured=25.0, limit=20.0)
    made = judged(bench, bound, stopped)
    assert made.reason is StopReason.FORCE_LIMIT
    assert sentences_of(made.clears) == ["RETRACT RIGHT-ARM"]
    free = judged(bench, bound, ended(stopped, StopReason.FORCE_LIMIT, trip_wrench=[0.0] * 6))
    assert free.clears == []


def test_fingers_that_hold_an_object_askew_are_not_advised_to_close_again(bench):
    assert bench.do(GRASP).succeeded
    bound, report = bound_and_done(bench, "VERIFY MACS-NEW AT RIGHT-ARM")
    wide = judged(bench, bound, ended(report, StopReason.GOAL, hand_width_m=report.hand_width_m + 0.005))
    assert "SET MACS-NEW FRAME" in in_one_line(wide.clears)
    assert not any(one.again for one in wide.clears)


def test_an_empty_hand_that_moves_freely_puts_nothing_in_doubt(bench):
    bound, report = bound_and_done(bench, "STOW RIGHT-ARM")

    made = judged(bench, bound, ended(report, StopReason.TIMEOUT))

    assert made.clears == [Alternative(again=True)]  # the advice of the class alone, without a doubtful fact


# --- how well it is known ----------------------------------------------------------------------------------


def test_a_grasp_knows_more_only_of_the_axis_it_felt(either):
    """The fingers tell where the handle is between them; along the approach and along the handle nothing was felt."""
    doubt = [0.01, 0.01, 0.01, 0.0, 0.0, 0.0]
    either.world = either.world.overlay([WorldChange(key="MACS-NEW.frame", keep_value=True, spread=doubt)])

    assert either.do(GRASP).succeeded

    for key in ("MACS-NEW.frame", "MACS-NEW.grasp"):
        assert either.world.get(key).spread == pytest.approx([0.01, 0.0028, 0.01, 0, 0, 0], abs=1e-3)


def test_what_is_held_is_known_less_with_every_step_and_stays_valid(bench):
    assert bench.do(GRASP).succeeded
    before = bench.world.get("MACS-NEW.grasp").spread

    assert bench.do("LIFT MACS-NEW BY 15 CM").succeeded

    fact = bench.world.get("MACS-NEW.grasp")
    assert all(now > then for now, then in zip(fact.spread, before, strict=True))
    assert fact.spread == bench.world.get("MACS-NEW.frame").spread
    assert fact.validity is Validity.VALID


@pytest.mark.parametrize("wider_m", [0.0007, -0.0007])
def test_fingers_that_move_while_they_hold_have_turned_the_bar_between_them(bench, wider_m):
    """A hand that closed askew on a seated module with friction 1.5 turned by 2 degrees, and widened by 0.7 mm."""
    assert bench.do(GRASP).succeeded
    bound, done = bound_and_done(bench, "LIFT MACS-NEW BY 15 CM", 1)
    as_before = change(judged(bench, bound, done), "MACS-NEW.grasp")
    moved = ended(done, done.reason, hand_width_m=done.hand_width_m + wider_m)

    after = change(judged(bench, bound, moved), "MACS-NEW.grasp")

    more = [math.degrees(b - a) for a, b in zip(as_before.spread[3:], after.spread[3:], strict=True)]
    turned = geometry.rotate(geometry.inverse(bench.world.value("MACS-NEW.grasp")), [2.0, 0.0, 2.0])
    assert more == pytest.approx([abs(n) for n in turned], abs=0.02)
    assert after.spread[2] > as_before.spread[2] + 0.0025  # at the origin, 8.5 cm beside the bar
    assert after.validity is Validity.VALID


def test_a_stated_pose_has_the_accuracy_of_an_observation(bench):
    assert bench.do("SET MACS-NEW FRAME 80 -80 61 CM").succeeded
    assert bench.world.get("MACS-NEW.frame").spread == pytest.approx([0.005] * 3 + [0.035] * 3)


def test_a_joint_that_does_not_move_is_named_instead_of_the_seat(bench):
    for sentence in (GRASP, "LIFT MACS-NEW BY 20 CM"):
        assert bench.do(sentence).succeeded
    script = bench.elaborate("INSERT MACS-NEW INTO RACK-1")
    n = next(n for n, step in enumerate(script.steps) if step.stop == "insert")
    for step in script.steps[:n]:
        bound = bench.bind(script, step)
        bench.world = bench.world.overlay(bench.analyze(bound, bench.subsystem.perform(bound.primitive, bound)).changes)
    bound = bench.bind(script, script.steps[n])
    done = bench.subsystem.perform(bound.primitive, bound)

    stuck = list(done.joints)
    stuck[1] = bound.evaluation.start_joints[1]
    short = [0.5 * (a + b) for a, b in zip(bound.evaluation.start_joints, done.joints, strict=True)]
    for reason in (StopReason.FORCE_LIMIT, StopReason.TIMEOUT):
        made = judged(bench, bound, ended(done, reason, joints=stuck))
        assert made.verdict == "abort"
        assert made.reason is StopReason.FOLLOWING_ERROR
        first = made.clears[0].sentences
        before = first[: first.index("RETRACT RIGHT-ARM")] if "RETRACT RIGHT-ARM" in first else first
        assert not any("RACK-1" in sentence for sentence in before)
        assert change(made, "RACK-1.frame") is None
        blocked = judged(bench, bound, ended(done, reason, joints=short))
        assert blocked.reason is reason
        assert change(blocked, "RACK-1.frame").validity is Validity.SUSPECT
