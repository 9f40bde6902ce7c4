"""MAINTAIN: every item with and without its argument, in the plan, and in motion against a disturbance in physics."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pybullet
import pytest

from rtc.language.parse import default_grammar, parse
from rtc.model.cells.parts import MAINTAINED, Frame, Maintained, Region
from rtc.programs import loader
from rtc.programs.extension_names import PARTNER
from rtc.programs.loader import decode
from rtc.programs.schema import ElaboratorProgram
from rtc.protocol import causes
from rtc.protocol.outcomes import Refusal, RefusalReason, StopReason
from rtc.protocol.primitive import (
    ClearanceBelow,
    ForceAbove,
    GripForceAbove,
    HandMotion,
    JointTrajectory,
    TcpInside,
    TcpOutside,
    TcpSpeedAbove,
    TcpTurned,
    TimeAbove,
    TorqueAbove,
)
from rtc.spatial import geometry
from rtc.spatial.solid_boxes import CORNERS
from rtc.wording.advice import in_one_line
from tests.refusals import stated
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery

ARM = "RIGHT-ARM"
physics = pytest.mark.physics
S1 = (
    "GRASP LEFT-END-EFF MACS-OLD HANDLE-A MAINTAIN SAFE-WORK-RANGE AVOID-TASK-REGION AVOID-NEIGHBORS "
    "POSE-DURING-MOTION SPEED GUARDED"
)
TO = f"MOVE {ARM} TO BAY-2-FRONT"
#: item, argument, limit in the script's context, and its value with and without the argument
ITEMS = [
    ("SAFE-WORK-RANGE", "BAY-2-RANGE", "work_range", "BAY-2-RANGE", "CELL-RANGE"),
    ("AVOID-TASK-REGION", "BAY-2-RANGE", "keep_out", ["BAY-2-RANGE"], ["SOLAR-ARRAY"]),
    ("AVOID-NEIGHBORS", "BY 2 CM", "clearance_m", 0.02, 0.01),
    ("POSE-DURING-MOTION", "LEVEL", "attitude", "LEVEL", "LEVEL"),
    ("SPEED", "5 CM/S", "speed_m_s", 0.05, 0.10),
    ("FORCE-LIMIT", "12 N", "force_n", 12.0, 30.0),
    ("TORQUE-LIMIT", "2 NM", "torque_nm", 2.0, 4.0),
    ("GRIP-FORCE", "20 N", "grip_force_n", 20.0, 30.0),
    ("STIFFNESS", "400 N/M", "stiffness_n_m", 400.0, 600.0),
    ("TIME-LIMIT", "60 SEC", "time_s", 60.0, 300.0),
]


def test_every_item_of_the_language_is_here() -> None:
    assert {item[0] for item in ITEMS} == set(MAINTAINED)


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: item[0])
def test_an_item_has_its_argument_or_what_the_cell_says(bench, item) -> None:
    slot, argument, limit, given, meant = item
    verb = f"CLOSE {ARM}" if slot == "GRIP-FORCE" else f"MOVE {ARM} BY 1 CM ALONG DOWN"
    for words, wanted in ((f" {argument}", given), ("", meant)):
        made = bench.elaborate(f"{verb} MAINTAIN {slot}{words}")
        if isinstance(made, Refusal):  # the arm is inside that region
            assert slot == "AVOID-TASK-REGION"
            assert isinstance(made.cause, causes.Collides)
        else:
            assert getattr(made.context.limits, limit) == wanted


@pytest.fixture(scope="module")
def silent(bench_model) -> CellModel:
    """A cell that gives no meanings."""
    return CellModel(msgspec.structs.replace(bench_model.cell, maintain=Maintained()))


@pytest.fixture(scope="module")
def bench_model() -> CellModel:
    from tests.workers.conftest import MODEL

    return MODEL


@pytest.mark.parametrize("slot", [item[0] for item in ITEMS])
def test_a_cell_that_gives_no_meaning_refuses_an_item_without_its_argument(bench, silent, slot) -> None:
    verb = f"CLOSE {ARM}" if slot == "GRIP-FORCE" else f"MOVE {ARM} BY 1 CM ALONG DOWN"
    refusal = bench.elaborate(f"{verb} MAINTAIN {slot}", silent)
    assert isinstance(refusal, Refusal)
    assert refusal.reason is RefusalReason.NO_SCRIPT
    assert refusal.where == slot
    assert f"give {slot} " in in_one_line(refusal.clears)


# --- in the plan -----------------------------------------------------------------------------------------


def bound(bench, sentence: str, step: int = 0):
    script = bench.elaborate(sentence)
    assert not isinstance(script, Refusal), script
    made = bench.bind(script, script.steps[step])
    assert not isinstance(made, Refusal), made
    return made.primitive


def conditions(primitive, kind: type) -> list:
    return [stop.when for stop in primitive.stop_functions if isinstance(stop.when, kind)]


def poses(bench, primitive) -> list:
    return [bench.model.arms[ARM].fk(q) for q in primitive.trajectory.positions]


@pytest.mark.parametrize(("words", "most_m_s"), [(" 5 CM/S", 0.05), ("", 0.10)])
def test_speed_is_planned_and_watched(bench, words, most_m_s) -> None:
    primitive = bound(bench, f"{TO} MAINTAIN SPEED{words}")
    way = primitive.trajectory
    arm = bench.model.arms[ARM]
    speeds = arm.tcp_speeds(np.array(way.positions), np.array(way.velocities))
    assert 0.8 * most_m_s < speeds.max() <= 1.02 * most_m_s
    assert conditions(primitive, TcpSpeedAbove) == [TcpSpeedAbove(pytest.approx(1.2 * most_m_s + 0.005))]


@pytest.mark.parametrize(
    ("item", "kind", "limit"),
    [
        ("FORCE-LIMIT 12 N", ForceAbove, "limit_n"),
        ("FORCE-LIMIT", ForceAbove, "limit_n"),
        ("TORQUE-LIMIT 2 NM", TorqueAbove, "limit_nm"),
        ("TORQUE-LIMIT", TorqueAbove, "limit_nm"),
    ],
)
def test_force_and_torque_limits_are_watched(bench, item, kind, limit) -> None:
    figure = {"FORCE-LIMIT 12 N": 12.0, "FORCE-LIMIT": 30.0, "TORQUE-LIMIT 2 NM": 2.0, "TORQUE-LIMIT": 4.0}[item]
    assert min(getattr(when, limit) for when in conditions(bound(bench, f"{TO} MAINTAIN {item}"), kind)) == figure


@pytest.mark.parametrize(("words", "grip_n"), [(" 20 N", 20.0), ("", 30.0)])
def test_grip_force_is_commanded_and_watched(bench, words, grip_n) -> None:
    primitive = bound(bench, f"CLOSE {ARM} MAINTAIN GRIP-FORCE{words}")
    assert isinstance(primitive.trajectory, HandMotion)
    assert primitive.trajectory.force_n == grip_n
    assert bench.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A").succeeded
    lift = bound(bench, f"LIFT MACS-NEW BY 10 CM MAINTAIN GRIP-FORCE{words}", 1)
    assert conditions(lift, GripForceAbove) == [GripForceAbove(pytest.approx(1.3 * grip_n + 3.0))]
    opens = bench.elaborate("RELEASE MACS-NEW").steps[0]  # it may have been held more strongly before this command
    let_go = bench.bind(bench.elaborate(f"LIFT MACS-NEW BY 10 CM MAINTAIN GRIP-FORCE{words}"), opens).primitive
    assert conditions(let_go, GripForceAbove) == []


@pytest.mark.parametrize(("off_deg", "watched_deg"), [(2.0, 6.0), (7.0, 8.1), (12.0, None)])
def test_a_hand_that_begins_off_its_attitude_comes_no_farther_off(bench, off_deg, watched_deg) -> None:
    place, level = bench.model.cell.place("BAY-2-FRONT").poses[ARM].pose, bench.model.cell.attitudes["LEVEL"].pose
    turn = geometry.from_rpy((0.0, 0.0, 0.0), (math.radians(off_deg), 0.0, 0.0))
    pose = geometry.make_pose(place[:3], geometry.compose(level, turn)[3:])
    bench.set_fact(f"{ARM}.joints", bench.model.arms[ARM].ik(pose, [0.0] * 6, 0.06)[0].tolist())
    sentence = f"MOVE {ARM} BY -5 CM ALONG TOOL-Z MAINTAIN POSE-DURING-MOTION LEVEL"
    if watched_deg is None:
        assert isinstance(bench.elaborate(sentence).cause, causes.OffAttitude)
        return
    made = bound(bench, sentence)
    assert conditions(made, TcpTurned)[0].limit_rad == pytest.approx(math.radians(watched_deg), abs=0.002)
    off = [geometry.angle(pose, level) for pose in poses(bench, made)]
    assert max(off) == pytest.approx(math.radians(off_deg), abs=0.001)


def test_only_the_first_hand_keeps_an_attitude(bench) -> None:
    assert bench.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A").succeeded
    assert bench.do("EXTRACT MACS-NEW FROM RACK-1").succeeded
    run = bench.do("CARRY MACS-NEW TO BAY-2-FRONT WITH BOTH-ARMS MAINTAIN POSE-DURING-MOTION LEVEL")
    assert run.succeeded, run.refusal
    moves = [made for made in run.primitives if isinstance(made.trajectory, JointTrajectory)]
    kept = {made.performer: bool(conditions(made, TcpTurned)) for made in moves}
    assert kept == {ARM: True, "LEFT-ARM": False}


def test_a_hand_that_holds_something_has_the_asked_force_before_its_arm_moves() -> None:
    """Else F of the first motion stops it for the force of an earlier command."""
    scripts = decode(loader.default("elaborator"), ElaboratorProgram).scripts
    asked = [one for one in scripts if "object_held" in one.needs and any(step.op == "close" for step in one.steps)]
    first = {
        one.script: [step for step in one.steps if step.who != PARTNER and step.do in ("move", "grip")] for one in asked
    }
    assert {"handoff", "carry", "extract", "lift"} <= first.keys()
    assert [name for name, steps in first.items() if steps and steps[0].do == "move"] == []


@pytest.mark.parametrize(("words", "stiffness"), [(" 400 N/M", 400.0), ("", 600.0)])
def test_stiffness_makes_the_arm_compliant(bench, words, stiffness) -> None:
    law = bound(bench, f"{TO} MAINTAIN STIFFNESS{words}").control_law
    assert law.name == "impedance"
    assert law.compliance.stiffness[:3] == [stiffness] * 3


def test_a_time_limit_is_that_of_all_motions_of_the_command(bench) -> None:
    script = bench.elaborate("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A MAINTAIN TIME-LIMIT 20 SEC")
    assert not isinstance(script, Refusal), script
    step = next(step for step in script.steps if step.to == "JAP")
    for moved_s, limit_s in ((0.0, 20.0), (8.0, 12.0)):
        made = bench.bind_after(script, step, moved_s)
        assert min(when.limit_s for when in conditions(made.primitive, TimeAbove)) <= limit_s
    late = bench.bind_after(script, step, 19.5)
    assert isinstance(late, Refusal)
    assert isinstance(late.cause, causes.TooLong)
    assert late.cause.moved_s == 19.5
    assert late.cause.limit_s == 20.0


def test_a_time_limit_without_an_argument_is_that_of_the_cell(bench) -> None:
    script = bench.elaborate(f"HOLD {ARM} MAINTAIN TIME-LIMIT")
    assert bench.bind(script, script.steps[0]).primitive.trajectory.duration_s == 300.0


def test_a_hold_longer_than_its_time_limit_is_refused(bench) -> None:
    refusal = bench.elaborate(f"HOLD {ARM} FOR 5 SEC MAINTAIN TIME-LIMIT 2 SEC")
    assert isinstance(refusal, Refusal)
    assert (refusal.where, refusal.reason) == ("TIME-LIMIT", RefusalReason.NO_SCRIPT)
    script = bench.elaborate(f"HOLD {ARM} FOR 2 SEC MAINTAIN TIME-LIMIT 2 SEC")
    assert bench.bind(script, script.steps[0]).primitive.trajectory.duration_s == 2.0


def test_the_hand_stays_in_its_range(bench) -> None:
    primitive = bound(bench, f"{TO} MAINTAIN SAFE-WORK-RANGE BAY-2-RANGE")
    region = bench.model.cell.region("BAY-2-RANGE")
    assert all(region.contains(pose[:3]) for pose in poses(bench, primitive))
    assert len(conditions(primitive, TcpOutside)) == 1
    assert len(conditions(bound(bench, f"{TO} MAINTAIN SAFE-WORK-RANGE"), TcpOutside)) == 1


def test_a_way_leads_round_a_region_that_must_be_avoided(bench) -> None:
    """A finger would pass through it otherwise."""
    region = bench.model.cell.region("SOLAR-ARRAY")
    assert bench.do(f"MOVE {ARM} TO POSITION 69 -77 96 CM").succeeded
    sentence = f"MOVE {ARM} TO POSITION 59 -4 112 CM"
    free, around = bound(bench, sentence), bound(bench, f"{sentence} MAINTAIN AVOID-TASK-REGION SOLAR-ARRAY")
    assert around.trajectory.positions != free.trajectory.positions
    assert not any(region.contains(pose[:3]) for pose in poses(bench, around))
    assert len(conditions(around, TcpInside)) == 1


def test_what_the_hand_holds_is_watched_in_ranges_and_regions(bench) -> None:
    """It was planned alone, and in regions alone."""
    assert bench.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A").succeeded
    words = "MAINTAIN SAFE-WORK-RANGE AND AVOID-TASK-REGION SOLAR-ARRAY"
    lift = bound(bench, f"LIFT MACS-NEW BY 10 CM {words}", 1)
    parts = len(bench.model.cell.object("MACS-NEW").shapes)
    assert [len(when.load) for kind in (TcpOutside, TcpInside) for when in conditions(lift, kind)] == [parts, parts]
    assert conditions(bound(bench, f"MOVE LEFT-ARM BY 1 CM ALONG DOWN {words}"), TcpInside)[0].load == []


@pytest.mark.parametrize(("room_m", "fits"), [(0.15, True), (0.03, False)])
def test_the_load_stays_in_the_range_of_its_hand(bench, room_m, fits) -> None:
    assert bench.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A").succeeded
    query = WorldQuery(bench.model, bench.world)
    hand = query.tcp(ARM)
    corners = [
        geometry.transform_point(geometry.compose(hand, box[:7]), corner * box[7:]) - hand[:3]
        for box in query.load_boxes(ARM)
        for corner in CORNERS
    ]
    size_m = tuple((2.0 * (np.abs(corners).max(axis=0) + room_m)).tolist())
    around = Region(name="AROUND", frame=Frame(xyz=tuple(hand[:3].tolist())), size_m=size_m)
    cell = bench.model.cell
    bench.model = CellModel(msgspec.structs.replace(cell, regions=[*cell.regions, around]))
    made = bench.elaborate("LIFT MACS-NEW BY 10 CM MAINTAIN SAFE-WORK-RANGE AROUND")
    if fits:
        assert not isinstance(made, Refusal), made
    else:
        assert isinstance(made, Refusal)
        assert made.cause.region == "AROUND"


def test_two_regions_are_avoided(bench) -> None:
    panel = Region(name="PANEL", frame=Frame(xyz=(0.7, 0.9, 0.7)), size_m=(0.2, 0.2, 0.2))
    cell = bench.model.cell
    bench.model = CellModel(msgspec.structs.replace(cell, regions=[*cell.regions, panel]))
    both = "MAINTAIN AVOID-TASK-REGION SOLAR-ARRAY AND AVOID-TASK-REGION PANEL"
    assert len(conditions(bound(bench, f"{TO} {both}"), TcpInside)) == 2
    for sentence, region in (("72 30 115", "SOLAR-ARRAY"), ("65 85 70", "PANEL")):
        refusal = bench.elaborate(f"MOVE LEFT-ARM TO POSITION {sentence} CM {both}")
        assert isinstance(refusal, Refusal)
        assert refusal.cause.body_b == f"{region} region"


@pytest.mark.parametrize(("words", "least_m"), [(" BY 3 CM", 0.025), ("", 0.005)])
def test_a_clearance_is_planned_and_watched_but_not_beside_what_the_command_is_about(bench, words, least_m) -> None:
    primitive = bound(bench, f"{TO} MAINTAIN AVOID-NEIGHBORS{words}")
    assert conditions(primitive, ClearanceBelow) == [ClearanceBelow(limit_m=pytest.approx(least_m))]
    grasp = bound(bench, f"GRASP RIGHT-END-EFF MACS-NEW HANDLE-A MAINTAIN AVOID-NEIGHBORS{words}", 2)
    assert len(conditions(grasp, ClearanceBelow)[0].except_near) == 2  # the module and its rack


def test_what_the_operator_moves_by_hand_keeps_its_distance_from_its_seat_too(bench) -> None:
    assert bench.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A").succeeded
    (watched,) = conditions(bound(bench, "GIVE RIGHT-ARM TO OPERATOR", 1), ClearanceBelow)
    assert watched.except_near == []


@pytest.mark.parametrize("words", [" LEVEL", ""])
def test_an_attitude_is_kept_all_the_way(bench, words) -> None:
    primitive = bound(bench, f"{TO} MAINTAIN POSE-DURING-MOTION{words}")
    assert all(
        geometry.angle(pose, geometry.make_pose((0, 0, 0), geometry.LEVEL)) < 0.09 for pose in poses(bench, primitive)
    )
    assert len(conditions(primitive, TcpTurned)) == 1


@pytest.mark.parametrize(
    ("sentence", "facts"),
    [
        (f"{TO} MAINTAIN SAFE-WORK-RANGE NOWHERE", {"what": "region", "name": "NOWHERE"}),
        (f"{TO} MAINTAIN SAFE-WORK-RANGE SOLAR-ARRAY", {"cause": "work_range", "region": "SOLAR-ARRAY"}),
        (f"{TO} MAINTAIN AVOID-TASK-REGION NOWHERE", {"what": "region", "name": "NOWHERE"}),
        (f"{TO} MAINTAIN AVOID-TASK-REGION BAY-2-RANGE", {"cause": "collision", "body_b": "BAY-2-RANGE region"}),
        (f"{TO} MAINTAIN AVOID-NEIGHBORS BY 0 CM", {"column": 58, "expected": ["a length such as 10 CM"]}),
        (f"{TO} MAINTAIN AVOID-NEIGHBORS BY 0.5 MM", {"where": "AVOID-NEIGHBORS"}),
        (f"{TO} MAINTAIN AVOID-NEIGHBORS BY 2 M", {"cause": "collision", "margin_m": 2.0}),
        (f"{TO} MAINTAIN POSE-DURING-MOTION SIDEWAYS", {"what": "attitude", "name": "SIDEWAYS"}),
        (f"{TO} MAINTAIN POSE-DURING-MOTION 5 DEG", {"column": 58}),
        (f"{TO} MAINTAIN SPEED 0 CM/S", {"column": 45, "expected": ["a speed such as 10 CM/S"]}),
        (f"{TO} MAINTAIN SPEED 5 DEG/S", {"where": "SPEED"}),
        (f"{TO} MAINTAIN SPEED 120 PERCENT", {"expected": ["100 PERCENT"]}),
        (f"{TO} MAINTAIN FORCE-LIMIT -3 N", {"column": 51, "expected": ["a force such as 20 N"]}),
        (f"{TO} MAINTAIN FORCE-LIMIT 3 NM", {"column": 51, "expected": ["a force such as 20 N"]}),
        (f"{TO} MAINTAIN TORQUE-LIMIT 3 N", {"expected": ["a torque such as 3 NM"]}),
        (f"HOLD {ARM} MAINTAIN TORQUE-LIMIT 3 NM", {"where": "TORQUE-LIMIT"}),
        (f"CLOSE {ARM} MAINTAIN GRIP-FORCE 90 N", {"value_n": 90.0, "limit_n": 60.0}),
        ("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A MAINTAIN GRIP-FORCE 0.2 N", {"where": "GRIP-FORCE", "cause": None}),
        ("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A MAINTAIN GRIP-FORCE 90 N", {"value_n": 90.0, "limit_n": 60.0}),
        (f"{TO} MAINTAIN GRIP-FORCE 20 N", {"where": "GRIP-FORCE"}),
        (f"{TO} MAINTAIN STIFFNESS 50 N/M", {"where": "STIFFNESS"}),
        (f"OPEN {ARM} MAINTAIN STIFFNESS 500 N/M", {"where": "STIFFNESS"}),
        (f"{TO} MAINTAIN TIME-LIMIT 0.1 SEC", {"cause": "time", "limit_s": 0.1}),
        (f"{TO} MAINTAIN TIME-LIMIT 3 N", {"expected": ["a time such as 30 SEC"]}),
        (f"{TO} MAINTAIN SHARED ELBOW", {"what": "part", "name": "ELBOW"}),
        (f"{TO} MAINTAIN SPEED AND SPEED", {"expected": ["each constraint once"]}),
        (f"{TO} UNLESS NO-PROGRESS THEN STOP", {"where": "NO-PROGRESS"}),
    ],
)
def test_a_wrong_argument_is_refused_and_nothing_moves(bench, sentence, facts) -> None:
    parsed = parse(default_grammar(), sentence)
    if isinstance(parsed, Refusal):
        assert stated(parsed, facts) == facts
        return
    run = bench.do(sentence)
    assert run.refusal is not None
    assert stated(run.refusal, facts) == facts
    assert not run.primitives


# --- in motion -------------------------------------------------------------------------------------------


@physics
def test_the_sentence_of_figure_2_is_executed_in_physics(physical) -> None:
    run = physical.do(S1)
    assert run.succeeded, run.refusal or [a.message for a in run.assessments]
    assert math.isclose(run.script.context.limits.speed_m_s, 0.1)


PALM = 7  # link of the URDF
LINE = f"MOVE {ARM} BY 3 CM ALONG DOWN MAINTAIN"


@pytest.fixture
def push(physical):
    """Push at the tcp from tick 1000 of every following primitive: force (N), torque (N.m), world axes."""

    def set_push(force=(0, 0, 0), torque=(0, 0, 0), until: int = 10_000) -> None:
        arm, client = physical.subsystem.sim.arms[ARM], physical.subsystem.sim.world.client

        def disturb(tick: int) -> None:
            if 1000 <= tick < until:
                at = arm.tcp_pose(arm._sample.joints)[:3].tolist()
                pybullet.applyExternalForce(arm.body, PALM, force, at, pybullet.WORLD_FRAME, physicsClientId=client)
                pybullet.applyExternalTorque(arm.body, PALM, torque, pybullet.WORLD_FRAME, physicsClientId=client)

        physical.subsystem.disturb = disturb

    return set_push


SOFT = "STIFFNESS 100 N/M AND FORCE-LIMIT 400 N"
# (item, what else the sentence maintains, push, reason). The others: tests/workers/test_conditions.py. An item without
# its argument is watched by the same predicate, see above.
DISTURBED = [
    ("FORCE-LIMIT", "SPEED 1 CM/S", ((0, 32, 0), (0, 0, 0)), StopReason.FORCE_LIMIT),
    ("TORQUE-LIMIT 2 NM", "SPEED 1 CM/S", ((0, 0, 0), (0, 0, 3)), StopReason.TORQUE_LIMIT),
    ("TIME-LIMIT 4 SEC", f"{SOFT} AND SPEED 1 CM/S", ((0, 3, 0), (0, 0, 0)), StopReason.TIMEOUT),
]


@physics
@pytest.mark.parametrize(("item", "others", "pushed", "reason"), DISTURBED, ids=lambda value: str(value)[:20])
def test_a_disturbance_in_motion_is_noticed(physical, push, item, others, pushed, reason) -> None:
    physical.load("binder", "values: {fast_factor: 1000}")  # a push is faster than the path
    push(*pushed)
    assert physical.do(f"{LINE} {item} AND {others}").reports[-1].reason is reason


@physics
@pytest.mark.parametrize(("words", "least_m"), [(" BY 3 CM", 0.025), ("", 0.005)])
def test_a_body_that_comes_near_stops_the_arm_before_it_touches(physical, words, least_m) -> None:
    """A module drifts towards the hand, which the world does not know."""
    sim = physical.subsystem.sim
    sim._detents.let_go("MACS-NEW")
    sim.world.place(sim.world.objects["MACS-NEW"], geometry.make_pose((0.95, -0.28, 1.12)))

    def drift(tick: int) -> None:
        if tick == 500:
            body = sim.world.objects["MACS-NEW"].id
            pybullet.resetBaseVelocity(body, [-0.05, 0.0, 0.0], physicsClientId=sim.world.client)

    physical.subsystem.disturb = drift
    report = physical.do(f"MOVE {ARM} BY 10 CM ALONG UP MAINTAIN AVOID-NEIGHBORS{words} AND SPEED 2 CM/S").reports[-1]
    assert report.reason is StopReason.OUT_OF_RANGE
    assert 0.0 < report.measured <= least_m
    assert report.peak_force_n < 5.0


@physics
def test_a_hand_that_is_pressed_too_hard_is_noticed(physical) -> None:
    assert physical.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A MAINTAIN GRIP-FORCE").succeeded
    hand = physical.subsystem.sim.arms[ARM]._hand
    physical.subsystem.disturb = lambda tick: setattr(
        hand, "command", msgspec.structs.replace(hand.command, force_n=55.0)
    )
    report = physical.do("LIFT MACS-NEW BY 4 CM WITH RIGHT-ARM MAINTAIN GRIP-FORCE 20 N").reports[-1]
    assert report.reason is StopReason.FORCE_LIMIT
    assert report.limit == pytest.approx(1.3 * 20.0 + 3.0)


@physics
def test_a_push_moves_a_soft_arm_by_what_its_stiffness_says(physical, push) -> None:
    physical.load("binder", "values: {fast_factor: 1000}")
    push((0, 6, 0))
    off = []
    arm = physical.subsystem.sim.arms[ARM]
    pushed = physical.subsystem.disturb
    physical.subsystem.disturb = lambda tick: (pushed(tick), off.append(arm.tcp_pose(arm._sample.joints)[1]))
    run = physical.do(f"{LINE} STIFFNESS 600 N/M AND SPEED 1 CM/S")
    assert run.reports, run.refusal
    moving = off[: round(1000 * run.primitives[-1].trajectory.time_s[-1])]  # at rest the command follows what presses
    assert max(moving) - moving[0] == pytest.approx(6.0 / 600.0, rel=0.15)
