"""Bolts turned by a driver in the hand: threads, torque, the way along the thread, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from benchmarks.force import Station
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.faults import StrippedBolt
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry, hinges
from rtc.subsystems.base.subsystem import BROKER
from rtc.subsystems.motion.arm import SpindleCommand
from rtc.subsystems.motion.subsystem import McmSubsystem
from sim_mcm.arms.kinematic_arm import KinematicCell
from sim_mcm.faults import Injections
from tests.workers.mechanisms.bolts.test_by_sentence import TURNS, with_short_bolts

CELL = with_short_bolts(Cell.load("servicing"))
ARM, BOLT, DRIVER = "RIGHT-ARM", "BOLT-1", "POWER-DRIVER"
THREAD, SPINDLE = CELL.object(BOLT).thread, CELL.object(DRIVER).spindle
PRESS = p.ControlLaw(
    name="impedance",
    gains={"wn": 100.0},
    compliance=p.Compliance(
        stiffness=[2000.0, 2000.0, 1000.0, 100.0, 100.0, 200.0], wrench=[None, None, 8.0, None, None, None]
    ),
)


@pytest.fixture
def station() -> Iterator[Station]:
    """The driver in the right hand, its tip on the head of the bolt."""
    made = Station(CELL, ARM)
    world = made.world.world
    door = world.objects["DOOR-2"]
    world.place(door, hinges.turned(door.home, door.hinge.axis, math.radians(95.0)))
    tip = geometry.compose(CELL.object_pose(BOLT), geometry.from_rpy((0, 0, 0), (math.pi, 0, 0)))
    grip = CELL.object(DRIVER).grasp_points[0].frame.pose
    tcp = geometry.compose(geometry.compose(tip, geometry.inverse(SPINDLE.frame.pose)), grip)
    made.to(geometry.translate(tcp, (-0.02, 0.0, 0.0)), 2.0)
    made.world._detents.let_go(DRIVER)
    world.place(world.objects[DRIVER], geometry.compose(made.tcp, geometry.inverse(grip)))
    made.end(made.begin(p.HandMotion(width_m=0.0, force_n=60.0)))
    felt = p.StopFunction(reason=StopReason.CONTACT, when=p.ForceAbove(limit_n=5.0, axis=[0.0, 0.0, -1.0]))
    assert made.line(np.array((0.03, 0.0, 0.0)), 0.01, felt).reason is StopReason.CONTACT
    yield made
    made.close()


def turn(station: Station, turns: float, *stops: p.StopFunction, torque_nm: float = 4.0) -> m.EndReport:
    motion = p.SpindleMotion(turn_rad=turns * math.tau, speed_rad_s=6.2, torque_nm=torque_nm)
    return station.end(station.begin(motion, *stops, law=PRESS))


@pytest.mark.physics
def test_a_bolt_is_stripped_stalled_tightened_and_turned_out(station) -> None:
    world, bolts = station.world.world, station.world.bolts

    faults = Injections(CELL, station.world, station.mcm.executors)
    assert "BOLT-1, BOLT-2" in faults.inject(StrippedBolt(bolt="BOLT-9"))
    assert faults.inject(StrippedBolt(bolt=BOLT)) == ""
    report = turn(station, -0.5)
    assert report.reason is StopReason.GOAL
    assert report.peak_torque_nm < 0.5
    assert world.out_m(BOLT) == pytest.approx(0.0, abs=2e-4)
    assert faults.undo(f"strip {BOLT}") == ("", "")

    late = p.StopFunction(reason=StopReason.TIMEOUT, when=p.TimeAbove(0.5))
    report = turn(station, -1.0, late, torque_nm=2.0)  # too weak: it stalls
    assert report.reason is StopReason.TIMEOUT
    assert report.turned_rad == 0.0

    limit = p.StopFunction(reason=StopReason.TORQUE_LIMIT, when=p.TorqueAbove(limit_nm=3.0))
    report = turn(station, 1.0, limit)  # it is tight already
    assert report.reason is StopReason.TORQUE_LIMIT
    assert bolts.out_turns(BOLT) == 0.0
    assert station.world.truth()["tight_nm"][BOLT][0] >= 3.0

    start = station.tcp
    held = geometry.relative(start, world.pose(DRIVER))
    report = turn(station, -TURNS)
    assert report.reason is StopReason.GOAL
    assert report.turned_rad == pytest.approx(-TURNS * math.tau, rel=1e-6)
    assert bolts.out_turns(BOLT) == pytest.approx(TURNS, abs=0.01)
    assert station.world.truth()["tight_nm"][BOLT] == [0.0]
    assert world.out_m(BOLT) == pytest.approx(TURNS * THREAD.pitch_m, abs=1e-4)
    assert start[0] - station.tcp[0] == pytest.approx(TURNS * THREAD.pitch_m, abs=1e-3)  # the tool follows the thread
    assert report.peak_torque_nm == pytest.approx(THREAD.breakaway_nm, abs=0.4)
    assert geometry.distance(geometry.relative(station.tcp, world.pose(DRIVER)), held) < 0.001

    name = station.begin(p.SpindleMotion(turn_rad=0.5 * math.tau, speed_rad_s=6.2, torque_nm=4.0), law=PRESS)
    list(station.tick(200))  # and in again, with a pause
    station.mcm.handle(m.SetPaused(primitive=name, paused=True), BROKER, 0.0)
    paced = [message for message in station.tick(5) if isinstance(message, m.PauseChanged)]
    paused_at = bolts.out_turns(BOLT)
    assert [message.paused for message in paced] == [True]
    assert paced[0].done == pytest.approx((TURNS - paused_at) / 0.5, abs=0.05)
    list(station.tick(300))
    assert bolts.out_turns(BOLT) == paused_at > TURNS - 0.4
    station.mcm.handle(m.SetPaused(primitive=name, paused=False), BROKER, 0.0)
    assert [message.paused for message in station.tick(5) if isinstance(message, m.PauseChanged)] == [False]
    assert station.end(name).turned_rad == pytest.approx(0.5 * math.tau, rel=1e-6)
    assert bolts.out_turns(BOLT) == pytest.approx(TURNS - 0.5, abs=0.01)

    arms = station.world.arms
    assert station.world.held()[ARM] == [DRIVER]
    with pytest.raises(ValueError, match="holds no driver"):
        arms["LEFT-ARM"].drive_spindle(SpindleCommand(1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="at most"):
        arms[ARM].drive_spindle(SpindleCommand(1.0, 1.0, SPINDLE.most_nm + 1.0))


@pytest.mark.parametrize("speed", [float("nan"), 0.0, -1.0])
def test_a_spindle_motion_checks_itself(speed) -> None:
    with pytest.raises(ValueError, match="speed"):
        p.SpindleMotion(turn_rad=1.0, speed_rad_s=speed, torque_nm=1.0)
    with pytest.raises(ValueError, match="turns by"):
        p.SpindleMotion(turn_rad=0.0, speed_rad_s=1.0, torque_nm=1.0)


def test_without_a_driver_in_the_hand_nothing_begins(make) -> None:
    world = KinematicCell(CELL)
    made = make.primitive(p.SpindleMotion(turn_rad=1.0, speed_rad_s=1.0, torque_nm=1.0))
    ((_, answer),) = McmSubsystem(world.arms, pid=1).handle(m.Execute(primitive=made), BROKER, 0.0)
    assert answer.reason is StopReason.REFUSED
    assert "physics" in answer.message  # wording: of a report, which has no cause
    assert world.arms[ARM].spindle().turned_rad == 0.0


@pytest.mark.physics
@pytest.mark.parametrize("friction", [0.8, 1.0, 1.2])
def test_the_wrist_feels_the_catch_of_the_rack(friction: float) -> None:
    """A catch that holds the attitude with 10 N.m twists what is pulled between the pads, and the simulated sensor
    misses that: it read 0.7 N where the catch pulled with 10 N, and a tug took the driver for free."""
    made = Station(CELL, ARM)
    grip = geometry.compose(CELL.object_pose(DRIVER), CELL.object(DRIVER).grasp_points[0].frame.pose)
    made.world.arms[ARM].rub(friction)
    made.to(geometry.compose(grip, (0.0, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0)), 2.0)
    assert made.line(geometry.rotate(grip, (0.0, 0.0, 0.1)), 0.05).reason is StopReason.GOAL
    made.end(made.begin(p.HandMotion(width_m=0.0, force_n=60.0)))
    felt = made.line(np.array((0.0, 0.0, 0.003)), 0.002)
    made.close()
    assert 8.0 < felt.peak_force_n < 12.0
