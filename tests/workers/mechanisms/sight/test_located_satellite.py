"""A satellite is turned and shifted, and a camera has located it: what is mounted on it is where the satellite is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtc.model.cells.cell import Cell
from rtc.protocol.advice import sentences_of
from rtc.protocol.messages import Script, Validity, WorldChange
from rtc.protocol.outcomes import RefusalReason
from rtc.protocol.primitive import Look, TurnAbove
from rtc.spatial import geometry, hinges
from sim_mcm.arms.kinematic_arm import displaced
from tests.workers.conftest import Bench, Physical, Reporter
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery

CELL = Cell.load("servicing")
MODEL = CellModel(CELL)
SATELLITE, DOOR, BOLT, BAY, MODULE = "SATELLITE", "DOOR-2", "BOLT-1", "BAY-2", "MACS-OLD"
LOCATE, LOCATE_DOOR = f"LOCATE {SATELLITE}", f"LOCATE {DOOR}"
GRASP, OPEN = f"GRASP LEFT-END-EFF {DOOR} LATCH-PULL", f"OPEN {DOOR} BY 60 DEG WITH LEFT-ARM"
HINGE, POINT = CELL.object(DOOR).hinge, CELL.object(DOOR).grasp_points[0].frame.xyz
DEEP_M = 0.005  # `deep_m` of GRASP: from the middle of the bar to the tcp
DEG = math.radians(1.0)
YAW, ALL_AXES = [0.005, 0.005, -0.005, 0.0, 0.0, DEG], [-0.004, 0.005, 0.005, DEG, DEG, -DEG]


def bench_with(offset: list[float]) -> Bench:
    """The satellite is off in truth, with all that is mounted on it; no one knows."""
    bench = Bench(Reporter(CELL), MODEL)
    bench.unsurveyed()
    poses = bench.subsystem.poses
    before = poses[SATELLITE]
    after = displaced(before, offset)
    for name in (SATELLITE, DOOR, "BOLT-1", "BOLT-2", MODULE):
        poses[name] = geometry.compose(after, geometry.relative(before, poses[name]))
    return bench


def fact(bench: Bench, body: str):
    return bench.world.get(f"{body}.frame")


def angle_deg(bench: Bench) -> float:
    return math.degrees(bench.world.value(f"{DOOR}.angle"))


def off_m(bench: Bench, body: str) -> float:
    return geometry.distance(fact(bench, body).value, bench.subsystem.poses[body])


@pytest.mark.parametrize("offset", [YAW, ALL_AXES], ids=["yaw", "all axes"])
@pytest.mark.parametrize("looks", [[LOCATE], [LOCATE, LOCATE_DOOR], [LOCATE_DOOR, LOCATE]], ids=" then ".join)
def test_a_door_turns_about_the_hinge_of_the_located_satellite(looks, offset) -> None:
    bench = bench_with(offset)
    home = bench.subsystem.poses[DOOR]  # in truth, at angle 0
    for look in looks:
        assert bench.do(look).succeeded
    assert angle_deg(bench) == pytest.approx(0.0, abs=0.01)
    assert bench.do(GRASP).succeeded
    run = bench.do(OPEN)
    assert run.succeeded, (run.refusal, run.failure)
    path, by_rad = run.primitives[-1].trajectory, math.radians(60.0) + 0.05  # farther by the lag of a compliant arm
    for angle, joints in ((0.0, path.positions[0]), (by_rad, path.positions[len(path.positions) - 1])):
        bar = geometry.transform_point(hinges.turned(home, HINGE.axis, angle), POINT)
        in_hand = geometry.transform_point(geometry.inverse(MODEL.arms["LEFT-ARM"].fk(joints)), bar)
        assert in_hand == pytest.approx([0.0, 0.0, -DEEP_M], abs=2e-4)
    (ends,) = [f.when for f in run.primitives[-1].stop_functions if isinstance(f.when, TurnAbove)]
    assert ends.point == pytest.approx(geometry.transform_point(home, (DEEP_M, 0.0, 0.0)), abs=2e-4)
    believed = bench.world.value(f"{DOOR}.frame")
    assert geometry.distance(believed, hinges.turned(home, HINGE.axis, math.radians(angle_deg(bench)))) < 2e-4
    assert geometry.angle(believed, hinges.turned(home, HINGE.axis, math.radians(angle_deg(bench)))) < 1e-3

    bench.subsystem.poses[DOOR] = hinges.turned(home, HINGE.axis, math.radians(60.0))  # the reporter turns no door
    assert bench.do(LOCATE_DOOR).succeeded
    assert angle_deg(bench) == pytest.approx(60.0, abs=0.01)
    closed = bench.do(f"CLOSE {DOOR}")
    assert closed.succeeded, (closed.refusal, closed.failure)
    assert angle_deg(bench) == pytest.approx(0.0, abs=2.1)


@pytest.mark.parametrize("offset", [YAW, ALL_AXES], ids=["yaw", "all axes"])
def test_a_held_door_hangs_on_the_hinge_of_the_satellite_that_is_located_then(offset) -> None:
    bench = bench_with(offset)
    home = bench.subsystem.poses[DOOR]
    assert bench.do(GRASP).succeeded  # beside the middle of the bar
    assert bench.do(LOCATE).succeeded
    query = WorldQuery(MODEL, bench.world)
    assert geometry.distance(query.hinge_home(DOOR), home) < 1e-6
    assert geometry.angle(query.hinge_home(DOOR), home) < 1e-6
    in_hand = geometry.compose(query.tcp("LEFT-ARM"), query.grasp(DOOR))
    assert geometry.distance(in_hand, query.frame(DOOR)) < 1e-6
    assert fact(bench, DOOR).validity is Validity.VALID
    assert max(fact(bench, DOOR).spread[3:]) > abs(query.angle(DOOR))  # in truth it is closed
    run = bench.do(OPEN)
    assert run.succeeded, (run.refusal, run.failure)
    frame = hinges.turned(home, HINGE.axis, math.radians(angle_deg(bench)))
    assert geometry.distance(bench.world.value(f"{DOOR}.frame"), frame) < 1e-6


def test_what_is_mounted_on_a_located_satellite_and_what_is_in_its_bay_goes_with_it() -> None:
    bench = bench_with(ALL_AXES)
    assert off_m(bench, BOLT) > 0.004
    assert off_m(bench, MODULE) > 0.004
    assert bench.do(LOCATE).succeeded
    for body in (SATELLITE, DOOR, BOLT, "BOLT-2", MODULE):
        assert off_m(bench, body) < 1e-6
        assert fact(bench, body).validity is Validity.VALID
    seated = WorldQuery(MODEL, bench.world).seated_pose(BAY)
    assert geometry.distance(seated, bench.subsystem.poses[MODULE]) < 1e-6
    assert max(fact(bench, BOLT).spread[:3]) > max(fact(bench, SATELLITE).spread[:3])  # by the lever of an angle


def test_a_bolt_stays_as_far_out_as_it_is() -> None:
    bench = bench_with(YAW)
    thread = CELL.object(BOLT).thread
    assert bench.do(f"SET {BOLT} STATE LOOSE").succeeded
    assert bench.do(LOCATE).succeeded
    out = geometry.relative(bench.subsystem.poses[BOLT], fact(bench, BOLT).value)
    assert out[:3] == pytest.approx([0.0, 0.0, thread.turns * thread.pitch_m], abs=1e-6)


def test_what_was_measured_better_and_agrees_stays_and_else_follows() -> None:
    bench = bench_with([0.0] * 6)
    seat = np.array(CELL.seat(BAY).frame.pose)
    known = geometry.translate(seat, (0.0, 0.001, 0.0)).tolist()
    bench.world = bench.world.overlay([WorldChange(key=f"{BAY}.frame", value=known, spread=[0.0005] * 6)])
    assert bench.do(LOCATE).succeeded
    assert fact(bench, BAY).value == known

    bench.subsystem.displace(SATELLITE, [0.0, 0.030, 0.0])
    assert bench.do(LOCATE).succeeded
    assert fact(bench, BAY).value[:3] == pytest.approx(geometry.translate(seat, (0.0, 0.030, 0.0))[:3], abs=1e-5)


def test_a_located_satellite_is_an_obstacle_where_it_is() -> None:
    """Its roof is 60 mm below the hand in the cell, and 40 mm above it in truth."""
    bench = bench_with([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    sentence = "MOVE RIGHT-ARM BY 15 CM ALONG FORWARD"
    assert isinstance(bench.elaborate(sentence), Script)
    assert bench.do(LOCATE).succeeded
    refusal = bench.elaborate(sentence)
    assert refusal.reason is RefusalReason.INFEASIBLE
    assert SATELLITE in refusal.cause.body_b


def test_a_satellite_that_only_track_has_seen_elsewhere_is_in_doubt_and_looked_for_first() -> None:
    """TRACK reserves nothing that is mounted on the satellite, so it places nothing."""
    bench = bench_with(YAW)
    before = fact(bench, SATELLITE).value
    track = bench.do(f"TRACK {SATELLITE} FOR 1 SEC VIA CAMERA-6")
    assert track.succeeded
    assert DOOR not in track.script.writes
    assert LOCATE in track.assessments[-1].found
    assert fact(bench, SATELLITE).value == before
    assert fact(bench, SATELLITE).validity is Validity.SUSPECT

    run = bench.do(GRASP)
    assert run.succeeded, (run.refusal, run.failure)
    assert isinstance(run.primitives[0].trajectory, Look)
    assert {SATELLITE, DOOR, BAY, BOLT, MODULE} <= set(run.script.writes)
    assert off_m(bench, SATELLITE) < 1e-6
    assert off_m(bench, DOOR) < 1e-3
    assert fact(bench, SATELLITE).validity is Validity.VALID


def test_a_satellite_that_track_has_seen_in_its_place_is_trusted() -> None:
    bench = bench_with([0.0] * 6)
    assert bench.do(f"TRACK {SATELLITE} FOR 1 SEC VIA CAMERA-6").succeeded
    assert fact(bench, SATELLITE).validity is Validity.VALID
    assert not isinstance(bench.do(GRASP).primitives[0].trajectory, Look)


def test_locate_reserves_what_it_places() -> None:
    script = bench_with(YAW).elaborate(LOCATE)
    assert {SATELLITE, DOOR, BAY, "BOLT-1", "BOLT-2", MODULE} <= set(script.writes)


@pytest.mark.physics
def test_in_physics_the_door_of_a_displaced_satellite_is_opened_after_one_look() -> None:
    subsystem = Physical(CELL)
    bench = Bench(subsystem, MODEL)
    assert not subsystem.sim.displace(SATELLITE, ALL_AXES)
    assert bench.do(LOCATE).succeeded
    felt_n: list[float] = []
    subsystem.disturb = lambda tick: felt_n.append(math.hypot(*subsystem.sim.arms["LEFT-ARM"].read().wrench[:3]))
    for sentence in (GRASP, OPEN):
        run = bench.do(sentence)
        assert run.succeeded, (run.refusal, run.failure)
    opened = math.degrees(subsystem.sim.world.angle(DOOR))
    subsystem.close()
    assert opened == pytest.approx(60.0, abs=2.0)
    assert angle_deg(bench) == pytest.approx(opened, abs=1.0)
    assert max(felt_n) < 10.0


def test_a_bay_that_is_not_seen_names_its_satellite_once() -> None:
    bench = bench_with([0.0] * 6)
    bench.subsystem.eyes.blind = True
    failure = bench.do(f"LOCATE {BAY}").failure
    assert failure is not None
    assert (failure.clears[0].sentences, failure.clears[0].again) == ([LOCATE], True)
    bench.subsystem.eyes.blind = False
    assert bench.do(LOCATE).succeeded
    bench.subsystem.eyes.blind = True
    assert LOCATE not in sentences_of(bench.do(f"LOCATE {BAY}").failure.clears)
