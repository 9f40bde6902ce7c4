"""Steps become primitives: where to, how fast, when to stop; and why not."""

from __future__ import annotations

import math
import re

import msgspec
import numpy as np
import pytest

from rtc.language import dictionary
from rtc.model.cells.cell import Cell
from rtc.model.robot.kinematics import ArmModel
from rtc.programs import loader
from rtc.protocol import causes, wire
from rtc.protocol.messages import Binding, BoundStep, GripStep, MoveStep, ProcedureStep, Script, Validity, WorldChange
from rtc.protocol.outcomes import ProgramError, Reflex, Refusal, RefusalReason, StopReason
from rtc.protocol.primitive import (
    BodyTouch,
    ForceAbove,
    GoalReached,
    GripForceBelow,
    HandMotion,
    HandWidthBelow,
    HoldStill,
    JointTrajectory,
    TimeAbove,
    TorqueAbove,
)
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line
from workers.binder import bind as binder
from workers.planning.motion import plan


def bound_to(bench, sentence: str, to: str) -> tuple[Script, BoundStep]:
    script = bench.elaborate(sentence)
    assert isinstance(script, Script), script
    step = next(s for s in script.steps if to in (s.to, s.op, s.name))
    bound = bench.bind(script, step)
    assert isinstance(bound, BoundStep), bound
    return script, bound


def stops(bound: BoundStep) -> dict[StopReason, object]:
    assert bound.primitive is not None
    return {stop.reason: stop.when for stop in reversed(bound.primitive.by_priority())}


def refused(bench, sentence: str, to: str) -> Refusal:
    script = bench.elaborate(sentence)
    assert isinstance(script, Script), script
    made = bench.bind(script, next(s for s in script.steps if to in (s.to, s.op, s.name)))
    assert isinstance(made, Refusal), made
    return made


# --- P -----------------------------------------------------------------------------------------------------


def test_a_motion_starts_where_the_arm_is_and_ends_at_its_goal(bench):
    script, bound = bound_to(bench, "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", "JAP")
    way = bound.primitive.trajectory

    assert isinstance(way, JointTrajectory)
    assert way.positions[0] == pytest.approx(bench.world.value("RIGHT-ARM.joints"))
    assert way.positions[-1] == pytest.approx(script.bindings["JAP"].joints)
    assert bound.subsystem == "MCM"
    assert bound.primitive.performer == "RIGHT-ARM"
    assert way.duration_s < bound.evaluation.predicted_s < way.duration_s + 0.05  # until the arm rests


@pytest.mark.parametrize(
    ("sentence", "most_m_s"),
    [
        ("MOVE RIGHT-ARM TO BAY-2-FRONT", 0.25),
        ("MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN SPEED 8 CM/S", 0.08),
        ("MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN SPEED 20 PERCENT", 0.05),
        ("MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN SPEED 2 M/S", 0.25),
    ],
)
def test_the_hand_keeps_its_speed(bench, sentence, most_m_s):
    _, bound = bound_to(bench, sentence, "GOAL")
    arm, way = bench.model.arms["RIGHT-ARM"], bound.primitive.trajectory

    speeds = [
        float(np.linalg.norm((arm.jacobian(q) @ np.array(v))[:3]))
        for q, v in zip(way.positions, way.velocities, strict=True)
    ]

    assert max(speeds) <= most_m_s * 1.02
    assert max(speeds) > most_m_s * 0.8


def test_a_step_from_here_goes_along_its_axis(bench):
    _, bound = bound_to(bench, "MOVE RIGHT-ARM BY 5 CM ALONG DOWN", "HERE")
    arm = bench.model.arms["RIGHT-ARM"]
    poses = [arm.fk(q) for q in bound.primitive.trajectory.positions]

    assert poses[-1][:3] - poses[0][:3] == pytest.approx([0.0, 0.0, -0.05], abs=1e-5)
    assert max(geometry.distance(p, [*poses[0][:2], p[2]]) for p in poses) < 1e-4  # straight
    assert geometry.angle(poses[0], poses[-1]) < 1e-4


def test_a_step_about_an_axis_turns_the_hand_on_the_spot(bench):
    _, bound = bound_to(bench, "MOVE RIGHT-ARM BY 20 DEG ALONG TOOL-Z", "HERE")
    arm = bench.model.arms["RIGHT-ARM"]
    start, end = (arm.fk(bound.primitive.trajectory.positions[n]) for n in (0, -1))

    assert geometry.distance(start, end) < 1e-4
    assert geometry.angle(start, end) == pytest.approx(math.radians(20), abs=1e-4)


def test_a_parameter_that_is_fixed_is_taken_as_it_is(bench):
    """R136."""
    script = bench.elaborate("STOW RIGHT-ARM")
    given = {"STOWED": Binding(joints=[0.1, 2.3, -2.6, 0.0, 0.3, 0.0])}

    bound = bench.bind(script, script.steps[0], given)

    assert bound.primitive.trajectory.positions[-1] == pytest.approx(given["STOWED"].joints)


def test_a_pose_of_an_object_is_bound_where_the_object_is_now(bench):
    """After a new location of the object the same binding goes elsewhere."""
    bench.do("APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM")
    script = bench.elaborate("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
    before = bench.bind(script, script.steps[7]).evaluation.goal_pose
    frame = bench.world.value("MACS-NEW.frame")
    bench.set_fact("MACS-NEW.frame", geometry.translate(frame, [0.0, 0.006, 0.0]).tolist())

    after = bench.bind(script, script.steps[7]).evaluation.goal_pose

    assert np.array(after[:3]) - np.array(before[:3]) == pytest.approx([0.0, 0.006, 0.0], abs=1e-6)


def test_the_plan_is_laid_down_anew_when_the_object_has_moved(bench):
    script = bench.elaborate("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
    step = next(s for s in script.steps if s.name == "grasp_plan")
    assert bench.bind(script, step).bindings == {}
    moved = geometry.translate(bench.world.value("MACS-NEW.frame"), [0.0, 0.01, 0.0])
    bench.set_fact("MACS-NEW.frame", moved.tolist())

    anew = bench.bind(script, step).bindings

    arm = bench.model.arms["RIGHT-ARM"]
    offset = arm.fk(anew["JAP"].joints)[:3] - arm.fk(script.bindings["JAP"].joints)[:3]
    assert offset == pytest.approx([0.0, 0.01, 0.0], abs=1e-6)


def test_the_middle_of_two_felt_poses(bench):
    script = bench.elaborate("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
    level = [0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)]
    given = {
        "GP1": Binding(pose=[0.65, -0.85, 0.60, *level]),
        "GP2": Binding(pose=[0.65, -0.91, 0.60, *level]),
    }

    bound = bench.bind(script, next(s for s in script.steps if s.do == "let"), given)

    assert bound.primitive is None
    assert bound.bindings["GP"].pose == pytest.approx([0.65, -0.88, 0.60, *level])


def test_poses_that_lie_too_far_apart_have_no_middle(bench):
    """A15: more than 5 degrees is a failure."""
    script = bench.elaborate("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
    level = geometry.make_pose([0.65, -0.85, 0.6], geometry.LEVEL)
    tilted = geometry.compose(level, geometry.from_rpy([0, 0, 0], [0, 0, math.radians(6)]))
    given = {"GP1": Binding(pose=level.tolist()), "GP2": Binding(pose=tilted.tolist())}

    made = bench.bind(script, next(s for s in script.steps if s.do == "let"), given)

    assert made.reason is RefusalReason.INFEASIBLE
    assert made.where == "GP"


def test_hands(bench):
    _, opened = bound_to(bench, "OPEN RIGHT-END-EFF TO 5 CM", "open")
    _, closed = bound_to(bench, "CLOSE RIGHT-END-EFF MAINTAIN GRIP-FORCE 25 N", "close")

    assert isinstance(opened.primitive.trajectory, HandMotion)
    assert opened.primitive.trajectory.width_m == pytest.approx(0.05)
    assert closed.primitive.trajectory == HandMotion(width_m=0.0, force_n=25.0, speed_m_s=0.05)


def test_a_grip_beyond_the_hands_force_is_refused(bench):
    step = "{do: grip, op: close, label: close, args: {grip_n: 80}}"
    bench.load("elaborator", f"script: close-hand\ncase: 1\nuses: [hand]\nsteps: [{step}]")
    refusal = refused(bench, "CLOSE RIGHT-END-EFF", "close")

    assert refusal.reason is RefusalReason.INFEASIBLE
    assert (refusal.cause.value_n, refusal.cause.limit_n) == (80, 60)
    assert "60 N" in in_one_line(refusal.clears)


def test_a_hand_is_not_opened_wider_than_it_goes(bench):
    refusal = refused(bench, "OPEN RIGHT-END-EFF BY 7 M", "open")

    assert refusal.reason is RefusalReason.INFEASIBLE
    assert refusal.cause.limit_m == 0.08
    assert refusal.cause.value_m == pytest.approx(7.08)


@pytest.mark.parametrize(
    ("sentence", "width_m"),
    [
        ("OPEN RIGHT-ARM BY 2 CM", 0.05),
        ("CLOSE RIGHT-ARM BY 2 CM", 0.01),
        ("OPEN RIGHT-ARM TO 2 CM", 0.02),
        ("CLOSE RIGHT-ARM TO 2 CM", 0.02),
        ("OPEN RIGHT-ARM", 0.08),
        ("CLOSE RIGHT-ARM", 0.0),
    ],
)
def test_by_is_relative_to_the_present_width_and_to_is_the_width(bench, sentence, width_m):
    bench.set_fact("RIGHT-ARM.hand_width", 0.03)
    script = bench.elaborate(sentence)

    bound = bench.bind(script, script.steps[0])

    assert bound.primitive.trajectory.width_m == pytest.approx(width_m)


def test_closing_by_more_than_the_hand_is_open_is_refused(bench):
    bench.set_fact("RIGHT-ARM.hand_width", 0.03)
    script = bench.elaborate("CLOSE RIGHT-ARM BY 5 CM")

    refusal = bench.bind(script, script.steps[0])

    assert isinstance(refusal, Refusal)
    assert refusal.cause.value_m == pytest.approx(-0.02)


def test_holding_has_an_end(bench):
    _, bound = bound_to(bench, "HOLD RIGHT-ARM FOR 5 SEC", "")

    assert bound.primitive.trajectory == HoldStill(duration_s=5.0)
    assert bound.limit_s > 5.0


# --- F -----------------------------------------------------------------------------------------------------


def test_a_free_motion_stops_on_any_touch(bench):
    _, bound = bound_to(bench, "MOVE RIGHT-ARM TO BAY-2-FRONT", "GOAL")
    when = stops(bound)

    assert when[StopReason.FORCE_LIMIT] == ForceAbove(limit_n=45.0)
    assert when[StopReason.COLLISION] == BodyTouch()
    assert isinstance(when[StopReason.GOAL], GoalReached)
    assert StopReason.CONTACT not in when


def test_a_feeling_motion_stops_on_what_opposes_it(bench):
    _, bound = bound_to(bench, "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", "JAP")
    bench.subsystem.joints["RIGHT-ARM"] = np.array(bound.primitive.trajectory.positions[-1])
    bench.set_fact("RIGHT-ARM.joints", bound.primitive.trajectory.positions[-1])
    script = bench.elaborate("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A GUARDED")
    jcm = bench.bind(script, script.steps[3])
    bench.set_fact("RIGHT-ARM.joints", jcm.primitive.trajectory.positions[-1])

    one, other = (stops(bench.bind(script, script.steps[n])) for n in (4, 5))

    assert one[StopReason.CONTACT].limit_n == other[StopReason.CONTACT].limit_n == 5.0
    assert one[StopReason.CONTACT].axis == pytest.approx([0, -1, 0], abs=1e-6)
    assert other[StopReason.CONTACT].axis == pytest.approx([0, 1, 0], abs=1e-6)
    assert one[StopReason.FORCE_LIMIT].limit_n == 20.0
    assert one[StopReason.TORQUE_LIMIT].limit_nm == 2.0  # GUARDED


def test_maintain_and_guarded_only_tighten(bench):
    for clause, limit_n in (
        ("MAINTAIN FORCE-LIMIT 8 N", 8.0),
        ("MAINTAIN FORCE-LIMIT 90 N", 40.0),
        ("GUARDED", 20.0),
        ("MAINTAIN FORCE-LIMIT 8 N GUARDED", 8.0),
    ):
        _, bound = bound_to(bench, f"RETRACT RIGHT-ARM {clause}", "HERE")
        assert stops(bound)[StopReason.FORCE_LIMIT].limit_n == limit_n, clause


LINE = "MOVE RIGHT-ARM BY 5 CM ALONG TOOL-Z"


def test_unless_runs_in_the_motion_loop(bench):
    clause = "UNLESS FORCE EXCEEDS 10 N THEN BACK-OFF BY 3 CM UNLESS TORQUE EXCEEDS 3 NM THEN RELEASE"
    _, bound = bound_to(bench, f"MOVE RIGHT-ARM TO BAY-2-FRONT {clause}", "GOAL")

    made = bound.primitive.by_priority()

    force = next(s for s in made if s.reason is StopReason.FORCE_LIMIT)
    torque = next(s for s in made if s.reason is StopReason.TORQUE_LIMIT)
    assert (force.when, force.reflex, force.back_off_m) == (ForceAbove(limit_n=10.0), Reflex.BACK_OFF, 0.03)
    assert (torque.when.limit_nm, torque.reflex) == (3.0, Reflex.RELEASE)


def _with_reflex(bound: BoundStep, reflex: Reflex) -> list:
    return [stop.when for stop in bound.primitive.by_priority() if stop.reflex is reflex]


def test_a_collision_of_the_hand_is_a_force_or_torque_beyond_the_limits_of_the_step(bench):
    """Only links are seen to touch. The reflex precedes the stop at the same limit."""
    clause = "MAINTAIN FORCE-LIMIT 30 N UNLESS COLLISION THEN BACK-OFF BY 5 CM REPORT WHEN COLLISION"
    _, bound = bound_to(bench, f"{LINE} {clause}", "HERE")
    touches = [BodyTouch(), ForceAbove(limit_n=30.0), TorqueAbove(limit_nm=12.0)]
    assert _with_reflex(bound, Reflex.BACK_OFF) == touches
    assert bound.primitive.by_priority()[0].reflex is Reflex.BACK_OFF
    assert [condition.when for condition in bound.primitive.reporting.when] == touches


def test_an_expected_touch_is_not_a_collision(bench):
    run = bench.elaborate("GRASP MACS-NEW UNLESS COLLISION THEN BACK-OFF")
    search = next(step for step in run.steps if step.stop == "move_to_contact")
    bound = bench.bind(run, search)
    felt_n = next(stop.when.limit_n for stop in bound.primitive.stop_functions if stop.reason is StopReason.CONTACT)
    forces_n = [when.limit_n for when in _with_reflex(bound, Reflex.BACK_OFF) if isinstance(when, ForceAbove)]
    assert forces_n == [20.0]
    assert felt_n < forces_n[0]


@pytest.mark.parametrize(
    ("sentence", "figures"),
    [
        (f"{LINE} UNLESS FORCE EXCEEDS 60 N THEN BACK-OFF", [45.0]),  # the line stops at 45 N
        (f"{LINE} UNLESS FORCE ALONG TOOL-Z EXCEEDS 60 N THEN COMPLY", [45.0, 45.0]),
        (f"{LINE} UNLESS FORCE EXCEEDS 30 N THEN BACK-OFF", [30.0]),
        (f"{LINE} UNLESS FORCE EXCEEDS 60 N THEN RELEASE", [60.0]),
        (f"{LINE} UNLESS TORQUE EXCEEDS 20 NM THEN BACK-OFF", [12.0]),
        ("HOLD RIGHT-ARM UNLESS TORQUE EXCEEDS 20 NM THEN COMPLY", [20.0]),  # no torque ends a HOLD by itself
    ],
)
def test_a_reflex_that_takes_the_force_away_acts_at_the_limit_of_the_step_at_the_latest(bench, sentence, figures):
    _, bound = bound_to(bench, sentence, "HERE" if "MOVE" in sentence else "")
    asked = [when for reflex in Reflex if reflex is not Reflex.STOP for when in _with_reflex(bound, reflex)]
    assert [getattr(when, "limit_n", None) or when.limit_nm for when in asked] == figures


def _speed_m_s(bound: BoundStep) -> float:
    """The greatest of the tcp, at the knots."""
    path, arm = bound.primitive.trajectory, ArmModel.of(Cell.load("swapout"), "RIGHT-ARM")
    rates = [arm.jacobian(q)[:3] @ v for q, v in zip(path.positions, path.velocities, strict=True)]
    return max(float(np.linalg.norm(rate)) for rate in rates)


@pytest.mark.parametrize("clause", ["UNLESS FORCE EXCEEDS 8 N THEN STOP", "MAINTAIN FORCE-LIMIT 8 N"])
def test_a_line_is_slowed_to_the_speed_at_which_the_force_can_be_kept(bench, clause):
    """A rigid body takes up effective mass times speed in one tick: 4 to 8 kg there."""
    _, bound = bound_to(bench, f"{LINE} {clause}", "HERE")
    assert 0.0008 < _speed_m_s(bound) < 0.0025
    assert re.search(r"slowed to \d\.\d+ mm/s: at 250 mm/s .* felt with \d{3,4} N; 8 N is kept up to", bound.note)


def test_a_force_goes_before_a_stated_speed_on_a_line(bench):
    _, bound = bound_to(bench, f"{LINE} MAINTAIN SPEED 3 CM/S UNLESS FORCE EXCEEDS 8 N THEN STOP", "HERE")
    assert _speed_m_s(bound) < 0.0025
    assert "slowed to" in bound.note
    assert bound.evaluation.remark in bound.note


def test_a_force_goes_before_a_stated_speed_wherever_a_touch_is_possible(bench):
    clause = "MAINTAIN SPEED 3 CM/S UNLESS FORCE EXCEEDS 8 N THEN STOP"
    speeds_m_s = []
    for sentence in (f"GRASP MACS-NEW {clause}", "GRASP MACS-NEW UNLESS FORCE EXCEEDS 8 N THEN STOP"):
        _, bound = bound_to(bench, sentence, "GP1")
        assert "slowed to" in bound.evaluation.remark
        speeds_m_s.append(_speed_m_s(bound))
    assert speeds_m_s[0] == pytest.approx(speeds_m_s[1])
    assert speeds_m_s[0] < 0.018  # of 20 mm/s


def test_a_force_on_a_free_way_is_called_a_collision_stop(bench):
    _, bound = bound_to(bench, "MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN FORCE-LIMIT 8 N", "GOAL")
    assert _speed_m_s(bound) > 0.1
    assert re.search(
        r"8 N is a collision stop on this free way: at 250 mm/s .* felt with \d+ N", bound.evaluation.remark
    )


def test_a_hand_that_backs_off_from_what_it_let_go_is_not_slowed_by_a_promised_force(bench, monkeypatch):
    """Behind an open hand is its own wrist: nothing else can be there."""
    bound, perform = [], bench.subsystem.perform
    monkeypatch.setattr(bench.subsystem, "perform", lambda made, step: bound.append(step) or perform(made, step))
    for sentence in ("GRASP MACS-NEW HANDLE-A WITH RIGHT-ARM", "RELEASE MACS-NEW WITH RIGHT-ARM GUARDED"):
        assert bench.do(sentence).succeeded
    assert 0.07 < _speed_m_s(bound[-1]) < 0.11
    assert "15 N is a collision stop on this free way" in bound[-1].evaluation.remark
    assert stops(bound[-1])[StopReason.FORCE_LIMIT].limit_n == 15.0


@pytest.mark.parametrize(
    "sentence", ["MOVE RIGHT-ARM BY 10 CM ALONG TOOL-Z GUARDED", "RETRACT RIGHT-ARM BY 20 CM GUARDED"]
)
def test_other_lines_are_slowed_by_it(bench, sentence):
    _, bound = bound_to(bench, sentence, "HERE")
    assert _speed_m_s(bound) < 0.012


@pytest.mark.parametrize(("clause", "limit_n"), [("GUARDED", 40.0), ("MAINTAIN STIFFNESS 200 N/M", 45.0)])
def test_guarded_and_stiffness_promise_the_force_of_their_step(bench, clause, limit_n):
    """4.6 to 9 kg in 1.1 ms: 5 to 12 mm/s."""
    _, bound = bound_to(bench, f"{LINE} {clause}", "HERE")
    assert stops(bound)[StopReason.FORCE_LIMIT].limit_n == limit_n
    assert 0.0035 < _speed_m_s(bound) < 0.012
    assert f"{limit_n:g} N is kept up to" in bound.evaluation.remark
    assert re.fullmatch(r"slowed to [\d.]+ mm/s", bound.remark)


def test_a_named_force_replaces_that_of_stiffness(bench):
    _, bound = bound_to(bench, f"{LINE} MAINTAIN STIFFNESS 200 N/M AND FORCE-LIMIT 4000 N", "HERE")
    assert _speed_m_s(bound) > 0.1


def test_a_force_that_no_speed_keeps_is_refused_with_the_least_one(bench):
    script = bench.elaborate(f"{LINE} MAINTAIN FORCE-LIMIT 0.5 N")
    refusal = bench.bind(script, script.steps[0])
    assert isinstance(refusal, Refusal)
    assert refusal.reason is RefusalReason.INFEASIBLE
    least_n = int(re.search(r"at least (\d+) N", in_one_line(refusal.clears))[1])
    bound_to(bench, f"{LINE} MAINTAIN FORCE-LIMIT {least_n} N", "HERE")  # the advice works


def test_a_long_line_keeps_its_force_where_the_arm_is_heavier(bench):
    """The effective mass grows from 9 to 20 kg along this line."""
    line = "MOVE RIGHT-ARM BY 20 CM ALONG BACK STRAIGHT-LINE MAINTAIN FORCE-LIMIT 20 N"
    _, bound = bound_to(bench, line, "HERE")
    path, arm = bound.primitive.trajectory, ArmModel.of(Cell.load("swapout"), "RIGHT-ARM")
    felt_n = []
    for q, v in zip(path.positions, path.velocities, strict=True):
        rate = arm.jacobian(q)[:3] @ v
        speed = float(np.linalg.norm(rate))
        felt_n.append(arm.effective_mass_kg(q, rate / speed) * speed / 0.0011 if speed > 0.0 else 0.0)
    assert 18.0 < max(felt_n) <= 20.5


def test_a_speed_looser_than_that_of_the_step_is_reported(bench):
    _, bound = bound_to(bench, f"{LINE} MAINTAIN SPEED 10 M/S", "HERE")
    assert bound.remark == "SPEED 1000 cm/s changes nothing"
    assert "SPEED 1000 cm/s changes nothing: this step moves at 25 cm/s at most" in bound.evaluation.remark


def test_a_relative_step_that_cannot_be_straight_says_how_far_the_hand_travels(bench):
    """The line would turn joint_5 beyond its margin, so the elbow turns over: 58 s for 8 cm."""
    for _ in range(3):
        assert bench.do("MOVE RIGHT-ARM BY -8 CM ALONG X").succeeded
    script, bound = bound_to(bench, "MOVE RIGHT-ARM BY -8 CM ALONG X MAINTAIN SPEED 3 CM/S", "HERE")
    assert bound.predicted_s > 30.0
    assert re.search(r"the hand travels [01]\.\d+ m to be 80 mm away", bound.evaluation.remark)
    assert "not in a straight line" in bound.evaluation.step.label
    assert any("joint_5" in note for note in script.notes)


@pytest.mark.parametrize(
    "clause",
    ["", "MAINTAIN FORCE-LIMIT 4000 N", "UNLESS CONTACT THEN STOP", "MAINTAIN SPEED 0.5 MM/S AND FORCE-LIMIT 8 N"],
)
def test_a_force_that_can_be_kept_is_not_mentioned(bench, clause):
    _, bound = bound_to(bench, f"{LINE} {clause}", "HERE")
    assert "slowed" not in bound.note


def test_a_load_beyond_the_payload_is_refused_before_it_is_moved(bench):
    assert bench.do("GRASP MACS-NEW HANDLE-A WITH RIGHT-ARM").succeeded
    bench.world = bench.world.overlay([WorldChange(key="MACS-NEW.mass", value=2.6)], source="C-9/9")
    script = bench.elaborate("LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM")
    refusal = bench.bind(script, script.steps[-1])
    assert isinstance(refusal, Refusal)
    assert refusal.reason is RefusalReason.INFEASIBLE
    assert isinstance(refusal.cause, causes.TooHeavy)
    assert (refusal.cause.mass_kg, refusal.cause.limit_kg) == (2.6, 2.5)


def test_a_force_along_an_axis_counts_both_ways(bench):
    _, bound = bound_to(
        bench, "MOVE RIGHT-ARM BY 5 CM ALONG TOOL-Z UNLESS FORCE ALONG TOOL-Z EXCEEDS 10 N THEN STOP", "HERE"
    )

    found = [s.when.axis for s in bound.primitive.stop_functions if s.reason is StopReason.FORCE_LIMIT]

    assert [0.0, 0.0, 1.0] in found
    assert [0.0, 0.0, -1.0] in found


def test_every_primitive_ends(bench):
    """F is complete (R82), and the wait for the report is longer than the arm's own limit."""
    for sentence in ("GRASP MACS-NEW", "STOW LEFT-ARM", "OPEN RIGHT-END-EFF", "HOLD RIGHT-ARM"):
        run = bench.elaborate(sentence)
        bound = bench.bind(run, run.steps[0])
        limit = stops(bound)[StopReason.TIMEOUT]
        assert isinstance(limit, TimeAbove)
        assert bound.evaluation.predicted_s < limit.limit_s < bound.limit_s


def test_what_is_held_is_watched(bench):
    bench.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")

    _, bound = bound_to(bench, "LIFT MACS-NEW BY 15 CM", "HERE")

    when = stops(bound)
    assert when[StopReason.OBJECT_LOST] == HandWidthBelow(pytest.approx(0.014))
    assert when[StopReason.SLIP] == GripForceBelow(3.0)
    assert bound.evaluation.held == "MACS-NEW"


def test_what_is_held_is_watched_however_thin_it_is(bench):
    bench.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
    bench.set_fact("RIGHT-ARM.hand_width", 0.004)

    _, bound = bound_to(bench, "LIFT MACS-NEW BY 15 CM UNLESS OBJECT-LOST THEN RELEASE", "HERE")

    lost = [stop.when for stop in bound.primitive.stop_functions if stop.reason is StopReason.OBJECT_LOST]
    assert lost == [HandWidthBelow(pytest.approx(0.002))] * 2


# --- refusals ----------------------------------------------------------------------------------------------


def test_a_collision_names_both_bodies(bench):
    script = bench.elaborate("STOW RIGHT-ARM")
    arm = bench.model.arms["RIGHT-ARM"]
    inside = arm.ik(geometry.make_pose([0.75, -0.30, 0.70], geometry.LEVEL))
    given = {"STOWED": Binding(joints=inside[0].tolist())}

    refusal = bench.bind(script, script.steps[0], given)

    assert refusal.reason is RefusalReason.INFEASIBLE
    assert isinstance(refusal.cause, causes.Collides)
    assert "SATELLITE" in f"{refusal.cause.body_a} {refusal.cause.body_b}"


def test_a_module_in_its_rack_cannot_be_carried_off_sideways(bench):
    bench.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
    script = bench.elaborate("MOVE RIGHT-ARM BY 10 CM ALONG UP")
    step = msgspec.structs.replace(script.steps[0], by_m=0.1, axis="Y")

    refusal = bench.bind(script, step)

    assert refusal.cause.owners == ("RACK-1", "MACS-NEW")


def test_a_time_limit_that_cannot_be_kept_is_reported_before_the_start(bench):
    refusal = refused(bench, "MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN TIME-LIMIT 1 SEC", "GOAL")

    assert isinstance(refusal.cause, causes.TooLong)


def test_a_suspect_frame_is_bound_upon_only_by_the_command_that_doubts_it(bench):
    """R151; a script has foreseen the doubts it raises itself, and is about to mend them."""
    bench.without_cameras()
    bench.do("APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM")
    script = bench.elaborate("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
    doubt = [WorldChange(key="MACS-NEW.frame", keep_value=True, validity=Validity.SUSPECT)]

    bench.world = bench.world.overlay(doubt, source=f"C-{bench.commands}/7")
    assert isinstance(bench.bind(script, script.steps[7]), BoundStep)
    bench.world = bench.world.overlay(doubt, source="C-99/7")
    refusal = bench.bind(script, script.steps[7])

    assert refusal.reason is RefusalReason.SUSPECT
    assert "SET MACS-NEW FRAME 80 -80 60 CM" in in_one_line(refusal.clears)


@pytest.mark.parametrize(
    ("step", "what", "name"),
    [
        (MoveStep(label="", to="NOWHERE", stop="move_free", space="move_task"), "binding", "NOWHERE"),
        (MoveStep(label="", to="STOWED", stop="move_fast", space="move_joint"), "stop class", "move_fast"),
        (MoveStep(label="", to="STOWED", stop="move_free", space="move_sideways"), "space", "move_sideways"),
        (ProcedureStep(label="", name="dance"), "procedure", "dance"),
        (GripStep(label="", op="tickle"), "motion of a hand", "tickle"),
        (
            MoveStep(label="", who="other_arm", to="STOWED", stop="move_free", space="move_joint"),
            "performer of steps",
            "other_arm",
        ),
    ],
)
def test_a_step_the_program_does_not_know_is_refused_by_name(bench, step, what, name):
    made = bench.bind(bench.elaborate("STOW RIGHT-ARM"), step)

    assert isinstance(made, Refusal)
    assert made.cause == causes.UnknownName(what=what, name=name)


def test_a_program_that_names_unknown_predicates_is_not_loaded():
    text = "stop_classes: {odd: {stops: [{reason: goal, when: goal-reached}, {reason: timeout, when: time-above}, \
{reason: slip, when: moon-full}]}}"

    with pytest.raises(ProgramError, match="moon-full"):
        loader.merge("binder", loader.default("binder"), "odd.yaml", text.encode())


def test_the_same_input_gives_the_same_primitive(bench):
    script = bench.elaborate("MOVE RIGHT-ARM TO BAY-2-FRONT")

    first, second = (bench.bind(script, script.steps[0]) for _ in range(2))

    assert wire.encode(first) == wire.encode(second)


def test_the_way_of_the_elaborator_is_not_tested_again(bench, monkeypatch):
    script = bench.elaborate("MOVE RIGHT-ARM TO BAY-2-FRONT")
    anew = bench.bind(script, msgspec.structs.replace(script.steps[0], way=None))
    asked = []
    for name in ("fault", "obstacle", "is_soon_free"):
        test = getattr(plan, name)
        monkeypatch.setattr(plan, name, lambda *about, test=test: asked.append(about) or test(*about))
    assert bench.bind(script, script.steps[0]) == anew
    assert not asked

    bench.set_fact("MACS-NEW.frame", [0.6, 0.6, 0.6, 0, 0, 0, 1])  # any fact of the scene
    assert bench.bind(script, script.steps[0]).primitive is not None
    assert asked


def test_a_way_is_not_used_once_a_module_stands_in_it(bench):
    script = bench.elaborate("MOVE RIGHT-ARM TO BAY-2-FRONT")
    goal = bench.bind(script, script.steps[0]).evaluation.goal_pose
    bench.set_fact("MACS-NEW.frame", goal)
    refusal = bench.bind(script, script.steps[0])
    assert isinstance(refusal, Refusal)
    assert refusal.cause.owners == ("RIGHT-ARM", "MACS-NEW")


@pytest.mark.parametrize(
    "sentence",
    [
        "MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN SPEED 0.0001 MM/S",
        "HOLD RIGHT-ARM FOR 1000000 SEC",
        "TRACK SATELLITE FOR 1000000 SEC",
    ],
)
def test_a_step_that_would_last_for_weeks_is_refused(bench, sentence):
    """No primitive can have its time limit; the job must not fail in its worker."""
    script = bench.elaborate(sentence)

    refusal = bench.bind(script, script.steps[0])

    assert isinstance(refusal, Refusal)
    assert refusal.reason is RefusalReason.INFEASIBLE
    assert refusal.cause.predicted_s > refusal.cause.limit_s == 1e6
    assert refusal.clears


@pytest.mark.parametrize("verb", sorted(dictionary.meanings().verbs))
def test_the_dictionary_gives_the_force_that_guarded_promises(verb):
    """Verbs without a script are proposals."""
    guarded = binder.compile(loader.default("binder")).guarded
    for use in dictionary.meanings().verbs[verb]:
        if use.of != "(no script yet)" and (figure := re.search(r"force (\d+) N", use.guarded)):
            assert float(figure[1]) == guarded.get(verb, guarded[""])["force_n"]


def test_a_plan_that_does_not_fit_what_was_measured_asks_for_a_new_one(bench):
    """The sentence is planned anew with what the look has found; the advice about joints has no sentence."""
    script = bench.elaborate("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
    step = next(s for s in script.steps if s.name == "grasp_plan")
    away = geometry.translate(bench.world.value("MACS-NEW.frame"), [0.0, 0.0, 3.0])
    bench.set_fact("MACS-NEW.frame", away.tolist())

    refusal = bench.bind(script, step)

    assert isinstance(refusal.cause, causes.OutOfReach)
    assert refusal.clears[0].again
