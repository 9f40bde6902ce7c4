"""UNLESS and MAINTAIN in physics, by whole sentences: each condition with a disturbance, and its wrong inputs."""

from __future__ import annotations

import math
from collections.abc import Callable

import pybullet
import pytest

from rtc.language.parse import default_grammar, parse
from rtc.protocol.outcomes import Reflex, Refusal, RefusalReason, StopReason
from rtc.protocol.primitive import TcpInside, TcpOutside, TcpSpeedAbove, TcpTurned
from rtc.spatial import geometry
from rtc.subsystems.motion.arm import HandCommand
from rtc.wording.advice import in_one_line
from tests.refusals import stated
from tests.workers.conftest import Bench, Kinematic

ARM = "RIGHT-ARM"
PALM = 7  # link of the URDF
physics = pytest.mark.physics


@pytest.fixture
def push(physical) -> Callable[..., None]:
    """Push at the tcp between two ticks of every following primitive: force (N) and torque (N.m), world axes."""

    def set_push(force=(0.0, 0.0, 0.0), torque=(0.0, 0.0, 0.0), *, since: int = 200, until: int = 1200) -> None:
        world = physical.subsystem.sim
        arm = world.arms[ARM]

        def disturb(tick: int) -> None:
            if since <= tick < until:
                at = arm.tcp_pose(arm._sample.joints)[:3].tolist()
                client = world.world.client
                pybullet.applyExternalForce(arm.body, PALM, force, at, pybullet.WORLD_FRAME, physicsClientId=client)
                pybullet.applyExternalTorque(arm.body, PALM, torque, pybullet.WORLD_FRAME, physicsClientId=client)

        physical.subsystem.disturb = disturb

    return set_push


def _end(run):
    assert run.refusal is None, run.refusal
    return run.reports[-1]


# Tool z is world x, and tool x is world -z, at home.
@physics
@pytest.mark.parametrize(
    ("condition", "force", "torque", "reason"),
    [
        ("FORCE BELOW 4 N", (8, 0, 0), (0, 0, 0), StopReason.FORCE_LIMIT),
        ("FORCE ALONG TOOL-Z BELOW 4 N", (8, 0, 0), (0, 0, 0), StopReason.FORCE_LIMIT),
        ("TORQUE BELOW 0.5 NM", (0, 0, 0), (1, 0, 0), StopReason.TORQUE_LIMIT),
        ("TORQUE ALONG TOOL-Z BELOW 0.5 NM", (0, 0, 0), (1, 0, 0), StopReason.TORQUE_LIMIT),
        ("NO-CONTACT", (8, 0, 0), (0, 0, 0), StopReason.NO_CONTACT),
    ],
)
def test_the_end_of_a_force_is_noticed(physical, push, condition, force, torque, reason) -> None:
    push(force, torque, since=200, until=600)
    run = physical.do(f"HOLD {ARM} FOR 3 SEC UNLESS {condition} THEN STOP")
    report = _end(run)
    assert report.reason is reason
    assert 0.6 < report.duration_s < 1.0
    assert run.failure.reason is reason


@physics
@pytest.mark.parametrize(
    ("condition", "force", "torque"),
    [
        ("FORCE BELOW 20 N", (8, 0, 0), (0, 0, 0)),  # never above it
        ("FORCE ALONG TOOL-X BELOW 4 N", (8, 0, 0), (0, 0, 0)),  # along another axis
        ("NO-CONTACT", (3, 0, 0), (0, 0, 0)),  # less than a contact
        ("TORQUE EXCEEDS 2 NM", (0, 0, 0), (1, 0, 0)),
    ],
)
def test_other_forces_do_not_stop_it(physical, push, condition, force, torque) -> None:
    push(force, torque, since=200, until=600)
    assert _end(physical.do(f"HOLD {ARM} FOR 1 SEC UNLESS {condition} THEN STOP")).reason is StopReason.GOAL


@physics
@pytest.mark.parametrize(
    ("condition", "force", "torque", "reason"),
    [
        ("FORCE EXCEEDS 6 N", (0, 8, 0), (0, 0, 0), StopReason.FORCE_LIMIT),
        ("FORCE ALONG TOOL-Y EXCEEDS 6 N", (0, 8, 0), (0, 0, 0), StopReason.FORCE_LIMIT),
        ("TORQUE EXCEEDS 0.5 NM", (0, 0, 0), (1, 0, 0), StopReason.TORQUE_LIMIT),
        ("TORQUE ALONG TOOL-Z EXCEEDS 0.5 NM", (0, 0, 0), (-1, 0, 0), StopReason.TORQUE_LIMIT),
        ("CONTACT", (8, 0, 0), (0, 0, 0), StopReason.CONTACT),
    ],
)
def test_a_force_stops_it(physical, push, condition, force, torque, reason) -> None:
    push(force, torque)
    report = _end(physical.do(f"HOLD {ARM} FOR 3 SEC UNLESS {condition} THEN STOP"))
    assert report.reason is reason
    assert report.duration_s < 2.5


@physics
def test_a_distance_is_measured_from_the_start_of_the_step_or_along_an_axis(physical) -> None:
    before = physical.model.arms[ARM].fk(physical.world.get(f"{ARM}.joints").value)
    run = physical.do(f"MOVE {ARM} BY 10 CM ALONG DOWN UNLESS DISTANCE EXCEEDS 4 CM THEN STOP")
    report = _end(run)
    assert report.reason is StopReason.OUT_OF_RANGE
    assert geometry.distance(report.trip_pose, before) == pytest.approx(0.04, abs=0.001)

    assert physical.do(f"MOVE {ARM} BY 5 CM ALONG DOWN UNLESS DISTANCE ALONG X EXCEEDS 1 CM THEN STOP").succeeded
    run = physical.do(f"MOVE {ARM} BY 5 CM ALONG TOOL-X UNLESS DISTANCE ALONG Z EXCEEDS 1 CM THEN STOP")
    assert _end(run).reason is StopReason.OUT_OF_RANGE


@physics
def test_a_distance_to_the_object_both_ways(physical) -> None:
    run = physical.do("APPROACH MACS-NEW HANDLE-A UNLESS DISTANCE BELOW 40 CM THEN STOP")
    at = physical.world.get("MACS-NEW.frame").value
    assert _end(run).reason is StopReason.CONTACT
    assert geometry.distance(_end(run).trip_pose, at) == pytest.approx(0.40, abs=0.002)


@physics
def test_a_grip_that_presses_too_much_is_a_condition(physical) -> None:
    assert physical.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A").succeeded
    assert _end(physical.do(f"HOLD {ARM} FOR 1 SEC UNLESS GRIP-FORCE EXCEEDS 35 N THEN STOP")).reason is StopReason.GOAL
    run = physical.do(f"HOLD {ARM} FOR 1 SEC UNLESS GRIP-FORCE EXCEEDS 20 N THEN STOP")
    assert _end(run).reason is StopReason.FORCE_LIMIT
    assert _end(run).measured == pytest.approx(30.0, rel=0.1)


@physics
def test_comply_gives_way_to_what_pushes_and_then_holds(physical, push) -> None:
    push((0, 0, 8), since=200, until=1000)
    run = physical.do(f"HOLD {ARM} FOR 10 SEC UNLESS FORCE EXCEEDS 6 N THEN COMPLY")
    report = _end(run)
    assert report.reason is StopReason.FORCE_LIMIT
    assert report.reflex is Reflex.COMPLY
    moved = geometry.relative(geometry.make_pose(report.trip_pose[:3]), geometry.make_pose(report.tcp_pose[:3]))
    assert moved[2] > 0.02  # 8 N for 0.8 s against the damping of a limp arm
    assert abs(report.wrench[2]) < 1.0
    physical.subsystem.disturb = None
    here = physical.subsystem.sim.arms[ARM].read().joints
    assert physical.do(f"HOLD {ARM} FOR 1 SEC").succeeded
    assert physical.subsystem.sim.arms[ARM].read().joints == pytest.approx(here, abs=1e-3)


@physics
def test_reports_are_sent_in_motion_periodically_and_on_a_condition(physical, push) -> None:
    push((0, 8, 0), since=400, until=700)
    report = "REPORT FORCES AND EVERY 0.2 SEC AND WHEN FORCE EXCEEDS 6 N AND WHEN TORQUE EXCEEDS 2 NM"
    assert physical.do(f"HOLD {ARM} FOR 1 SEC {report}").succeeded
    sent = physical.subsystem.progress
    assert [one.condition for one in sent][:5] == [None, None, 0, None, None]
    assert len(sent) <= 6
    assert sent[2].measured == pytest.approx(8.0, abs=2.0)
    assert sent[2].limit == 6.0


@physics
@pytest.mark.parametrize(
    "sentence",
    [
        f"MOVE {ARM} BY 30 DEG ALONG TOOL-Z UNLESS TURN EXCEEDS 10 DEG THEN STOP",
        f"MOVE {ARM} BY -30 DEG ALONG TOOL-Z UNLESS TURN ALONG TOOL-Z EXCEEDS 10 DEG THEN STOP",
        f"MOVE {ARM} BY 30 DEG ALONG TOOL-Z UNLESS TURN ALONG JOINT-6 EXCEEDS 10 DEG THEN STOP",
    ],
)
def test_a_turn_of_the_hand_or_of_a_joint_is_a_condition(physical, sentence) -> None:
    report = _end(physical.do(sentence))
    assert report.reason is StopReason.OUT_OF_RANGE
    assert report.limit == pytest.approx(math.radians(10.0))
    assert report.measured == pytest.approx(0.1745, abs=0.003)


@physics
def test_a_soft_arm_that_a_wall_keeps_from_its_path_makes_no_progress(physical) -> None:
    physical.subsystem.displace("SATELLITE", [-0.088, 0.0, 0.0])
    assert physical.do(f"MOVE {ARM} BY 15 CM ALONG DOWN").succeeded
    soft = "MAINTAIN STIFFNESS 1200 N/M AND SPEED 4 MM/S"
    run = physical.do(f"MOVE {ARM} BY 4 CM ALONG TOOL-Z {soft} UNLESS NO-PROGRESS THEN STOP")
    report = _end(run)
    assert report.reason is StopReason.FORCE_LIMIT
    assert report.measured == pytest.approx(0.015, abs=0.002)


@physics
def test_a_clearance_is_a_condition(physical) -> None:
    """The satellite is nearer than the world has it."""
    physical.subsystem.displace("SATELLITE", [-0.06, 0.0, 0.0])
    assert physical.do(f"MOVE {ARM} BY 15 CM ALONG DOWN").succeeded
    report = _end(physical.do(f"MOVE {ARM} BY 6 CM ALONG TOOL-Z UNLESS CLEARANCE BELOW 2 CM THEN STOP"))
    assert report.reason is StopReason.OUT_OF_RANGE
    assert 0.015 < report.measured < 0.02
    assert report.peak_force_n < 15.0  # of braking


@physics
def test_a_grip_that_weakens_while_the_hand_closes_is_a_slip(physical) -> None:
    """The pressing force is taken away when it has been reached."""
    sentence = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A UNLESS SLIP THEN STOP"
    executor = physical.subsystem.executors[ARM]
    pressed = []

    def disturb(tick: int) -> None:
        forces = min(executor.sample.finger_forces)
        if pressed or forces > 5.0:
            pressed.append(tick)
            physical.subsystem.sim.arms[ARM]._hand.command = HandCommand(0.08, 30.0, 0.05)

    physical.subsystem.disturb = disturb
    run = physical.do(sentence)
    assert StopReason.SLIP in [report.reason for report in run.reports]


@physics
def test_release_stops_and_opens_the_hand(physical, push) -> None:
    assert physical.do(f"CLOSE {ARM}").succeeded
    push((0, 0, 12))
    run = physical.do(f"HOLD {ARM} FOR 3 SEC UNLESS FORCE EXCEEDS 8 N THEN RELEASE")
    report = _end(run)
    assert (report.reason, report.reflex) == (StopReason.FORCE_LIMIT, Reflex.RELEASE)
    assert report.hand_width_m == pytest.approx(0.08, abs=0.001)


@physics
def test_backing_off_ends_at_what_the_arm_meets_on_its_way_back(physical) -> None:
    """The module behind the hand was not there when the hand came."""
    sim = physical.subsystem.sim
    assert physical.do(f"MOVE {ARM} BY 2 CM ALONG TOOL-Z").succeeded
    state = {"pushed": False}

    def disturb(tick: int) -> None:
        arm = sim.arms[ARM]
        executor = physical.subsystem.executors[ARM]
        if executor.state.value == "executing" and tick > 1500:
            at = arm.tcp_pose(arm._sample.joints)[:3].tolist()
            client = sim.world.client
            pybullet.applyExternalForce(arm.body, PALM, (-9, 0, 0), at, pybullet.WORLD_FRAME, physicsClientId=client)
        elif executor.state.value == "retreating" and tick > 2300:
            at = arm.tcp_pose(arm._sample.joints)[:3].tolist()
            client = sim.world.client
            pybullet.applyExternalForce(arm.body, PALM, (60, 0, 0), at, pybullet.WORLD_FRAME, physicsClientId=client)
            state["pushed"] = True

    physical.subsystem.disturb = disturb
    sentence = f"MOVE {ARM} BY 6 CM ALONG BACK MAINTAIN SPEED 2 CM/S UNLESS FORCE EXCEEDS 6 N THEN BACK-OFF BY 3 CM"
    report = _end(physical.do(sentence))
    assert state["pushed"]
    assert report.reflex is Reflex.STOP
    assert geometry.distance(report.trip_pose, report.tcp_pose) < 0.028


@physics
@pytest.mark.parametrize(
    ("constraint", "force", "torque", "reason", "watched"),
    [
        ("SAFE-WORK-RANGE BAY-2-RANGE", (0, 0, 16), (0, 0, 0), StopReason.OUT_OF_RANGE, TcpOutside),
        ("AVOID-TASK-REGION SOLAR-ARRAY", (14, 0, 8), (0, 0, 0), StopReason.OUT_OF_RANGE, TcpInside),
        ("POSE-DURING-MOTION LEVEL", (0, 0, 0), (0, 0, 1), StopReason.OUT_OF_RANGE, TcpTurned),
        ("SPEED 1 CM/S", (0, 25, 0), (0, 0, 0), StopReason.OVERSPEED, TcpSpeedAbove),
    ],
)
def test_a_constraint_is_kept_in_motion_too(physical, push, constraint, force, torque, reason, watched) -> None:
    """A soft arm is pushed while it moves 3 cm, in 3 s."""
    other = "" if "SPEED" in constraint else " AND SPEED 1 CM/S"
    if other:  # the push is faster than the path
        physical.load("binder", "values: {fast_factor: 1000}")
    line = f"MOVE {ARM} BY 3 CM ALONG DOWN MAINTAIN STIFFNESS 100 N/M AND FORCE-LIMIT 400 N AND {constraint}{other}"
    assert physical.do(f"MOVE {ARM} BY 3 CM ALONG DOWN").succeeded
    push(force, torque, since=1000, until=5000)
    run = physical.do(line.replace("DOWN", "UP"))
    report = _end(run)
    assert report.reason is reason
    assert [type(stop.when) for stop in run.primitives[-1].stop_functions if stop.reason is reason] == [watched]
    assert reason is not StopReason.OVERSPEED or report.limit == pytest.approx(0.017)  # of the tcp, not of a joint


@pytest.mark.parametrize(
    ("clause", "facts"),
    [
        ("UNLESS FORCE BELOW -3 N THEN STOP", {"column": 51, "expected": ["a force such as 20 N"]}),
        ("UNLESS FORCE ALONG NOWHERE BELOW 3 N THEN STOP", {"what": "axis", "name": "NOWHERE"}),
        ("UNLESS DISTANCE BELOW 3 CM THEN STOP", {"where": "UNLESS DISTANCE BELOW"}),
        ("UNLESS DISTANCE ALONG NOWHERE EXCEEDS 3 CM THEN STOP", {"what": "axis", "name": "NOWHERE"}),
        ("UNLESS GRIP-FORCE ALONG TOOL-Z EXCEEDS 3 N THEN STOP", {"where": "UNLESS GRIP-FORCE ALONG TOOL-Z EXCEEDS"}),
        ("UNLESS TORQUE BELOW 3 N THEN STOP", {"column": 52, "expected": ["a torque such as 3 NM"]}),
        ("UNLESS CLEARANCE ALONG X BELOW 2 CM THEN STOP", {"where": "UNLESS CLEARANCE ALONG X BELOW"}),
        ("UNLESS CLEARANCE BELOW 0 CM THEN STOP", {"column": 55, "expected": ["a length such as 10 CM"]}),
        ("UNLESS CLEARANCE EXCEEDS 2 CM THEN STOP", {"where": "UNLESS CLEARANCE EXCEEDS"}),
        ("UNLESS TURN BELOW 20 DEG THEN STOP", {"where": "UNLESS TURN BELOW"}),
        ("UNLESS TURN EXCEEDS 200 DEG THEN STOP", {"where": "UNLESS TURN EXCEEDS", "expected": []}),
        ("UNLESS TURN ALONG JOINT-7 EXCEEDS 20 DEG THEN STOP", {"what": "joint", "name": "JOINT-7"}),
        ("UNLESS TURN ALONG JOINT-0 EXCEEDS 20 DEG THEN STOP", {"what": "joint", "name": "JOINT-0"}),
        ("UNLESS FORCE ALONG JOINT-1 EXCEEDS 20 N THEN STOP", {"what": "axis", "name": "JOINT-1"}),
        ("UNLESS NO-PROGRESS THEN STOP", {"where": "NO-PROGRESS"}),
        ("UNLESS SLIP THEN STOP", {"where": "SLIP"}),
        ("UNLESS OBJECT-LOST THEN STOP", {"where": "OBJECT-LOST"}),
        ("UNLESS GRIP-FORCE BELOW 5 N THEN STOP", {"where": "GRIP-FORCE BELOW"}),
        ("REPORT WHEN SLIP", {"where": "SLIP"}),
        ("REPORT WHEN DISTANCE BELOW 3 CM", {"where": "REPORT WHEN DISTANCE BELOW"}),
        ("REPORT WHEN FORCE ALONG NOWHERE EXCEEDS 3 N", {"what": "axis", "name": "NOWHERE"}),
        ("REPORT EVERY 0.01 SEC", {"where": "EVERY"}),
        ("MAINTAIN SAFE-WORK-RANGE NOWHERE", {"what": "region", "name": "NOWHERE"}),
    ],
)
def test_a_wrong_condition_is_refused_before_anything_moves(bench, clause, facts) -> None:
    sentence = f"MOVE {ARM} BY 5 CM ALONG UP {clause}"
    parsed = parse(default_grammar(), sentence)
    refusal = parsed if isinstance(parsed, Refusal) else bench.elaborate(sentence)
    assert isinstance(refusal, Refusal), refusal
    assert stated(refusal, facts) == facts


@pytest.mark.parametrize("verb", [f"HOLD {ARM} FOR 1 SEC", f"OPEN {ARM}", f"CLOSE {ARM}"])
def test_an_arm_that_stays_cannot_back_off(bench, verb) -> None:
    refusal = bench.elaborate(f"{verb} UNLESS FORCE EXCEEDS 6 N THEN BACK-OFF BY 1 CM")
    assert isinstance(refusal, Refusal), refusal
    assert (refusal.reason, refusal.where) == (RefusalReason.NO_SCRIPT, "BACK-OFF")


@pytest.mark.parametrize("clause", ["UNLESS CONTACT THEN COMPLY", "MAINTAIN STIFFNESS 600 N/M"])
def test_an_exact_arm_that_is_to_comply_does_not_begin_and_the_cure_is_named(clause) -> None:
    exact = Bench(Kinematic())
    before = list(exact.subsystem.sim.arms[ARM].read().joints)

    run = exact.do(f"MOVE {ARM} BY 5 CM ALONG UP {clause}")

    assert [report.reason for report in run.reports] == [StopReason.REFUSED]
    assert run.failure is not None
    assert "message names" in in_one_line(run.failure.clears)  # to repeat it alone is of no use
    assert list(exact.subsystem.sim.arms[ARM].read().joints) == before
