"""Pauses on the path: smooth, within the limits, and resumed where they began."""

from __future__ import annotations

import numpy as np
import pytest

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.protocol.versions import PAUSES, RIGID
from rtc.subsystems.motion.arm import TICK_S
from rtc.subsystems.motion.modes import Mode
from rtc.subsystems.motion.pace import RAMPS_S

SLOWEST_TICKS = round(RAMPS_S[-1] / TICK_S) + 2


def swing(rig, make, *stops: p.StopFunction, duration_s: float = 2.0, limit_s: float = 30.0) -> p.Primitive:
    """A motion of two joints that are not proportional: a curve in the space of the joints."""
    q = np.array(rig.home)
    knots = [q, q + np.array([0.3, 0.05, 0, 0, 0, 0]), q + np.array([0.4, 0.3, 0, 0, 0, 0])]
    rates = [[0.0] * 6, ((knots[2] - knots[0]) / duration_s).tolist(), [0.0] * 6]
    path = p.JointTrajectory(
        space="joint",
        time_s=[0.0, 0.5 * duration_s, duration_s],
        positions=[knot.tolist() for knot in knots],
        velocities=rates,
        accelerations=[[0.0] * 6] * 3,
    )
    return make.primitive(path, *stops, limit_s=limit_s)


def paced(sent) -> list[bool]:
    return [message.paused for message in sent if isinstance(message, m.PauseChanged)]


def stand(rig) -> None:
    """Pause, and wait until the arm stands."""
    rig.executor.pace(True)
    rig.tick(SLOWEST_TICKS)
    assert paced(rig.sent)[-1]


@pytest.mark.parametrize("at_tick", [1, 240, 666, 1000, 1400, 1880])
def test_a_paused_arm_stays_on_its_path_within_its_acceleration_limits(rig, make, at_tick) -> None:
    wanted = swing(rig, make)
    rig.accept(wanted)
    path = make.Follow(wanted.trajectory, rig.home)
    line = path.path(np.linspace(0.0, 2.0, 20001))[:, 0]
    own = np.abs(path.path(np.linspace(0.0, 2.0, 1001))[:, 2]).max(axis=0)
    rig.tick(at_tick)
    stand(rig)
    still = rig.arm.commands[-1]
    assert not any(still[1])
    assert not any(still[2])
    rig.tick(500)
    assert rig.arm.commands[-1] == still
    rig.executor.pace(False)
    assert rig.until_end().reason is StopReason.GOAL
    commands = np.array(rig.arm.commands)
    on_path = np.interp(commands[:, 0, 0], line[:, 0], line[:, 1])  # the first joint moves in one direction only
    assert np.abs(commands[:, 0, 1] - on_path).max() < 1e-6
    most = np.maximum(own, rig.arm.traits.acceleration)
    assert (np.abs(commands[:, 2]) <= 1.01 * most).all()
    differences = np.diff(commands[:, 0], axis=0) / TICK_S
    assert np.abs(differences - commands[1:, 1]).max() < 0.01  # the velocities are those of the positions


def test_a_pause_lasts_as_long_as_it_is_ordered_and_changes_nothing_of_the_path(rig, make) -> None:
    wanted = swing(rig, make)
    rig.accept(wanted)
    rig.tick(800)
    stand(rig)
    rig.executor.pace(False)
    report = rig.until_end()
    assert paced(rig.sent) == [True, False]
    assert report.joints == pytest.approx(wanted.trajectory.positions[-1])
    assert report.duration_s > 2.0 + SLOWEST_TICKS * TICK_S - RAMPS_S[-1]
    assert report.moved_s is not None
    assert report.moved_s + 0.9 * report.paused_s < report.duration_s


def test_an_order_during_a_ramp_takes_effect_after_it(rig, make) -> None:
    rig.accept(swing(rig, make))
    rig.tick(800)
    rig.executor.pace(True)
    rig.tick(20)
    rig.executor.pace(False)
    assert rig.until_end().reason is StopReason.GOAL
    rates = np.abs(np.array(rig.arm.commands)[:, 1, 0])
    assert rates[800:1500].min() == 0.0


def test_repeated_orders_change_nothing(rig, make) -> None:
    rig.accept(swing(rig, make))
    rig.tick(800)
    stand(rig)
    rig.executor.pace(True)
    rig.tick(50)
    rig.executor.pace(False)
    rig.executor.pace(False)
    assert rig.until_end().reason is StopReason.GOAL
    assert paced(rig.sent) == [True, False]


@pytest.mark.parametrize("before_halt", [30, SLOWEST_TICKS, "resuming"])
def test_a_halt_ends_the_motion_while_it_pauses_is_paused_or_goes_on(rig, make, before_halt) -> None:
    rig.accept(swing(rig, make))
    rig.tick(900)
    rig.executor.pace(True)
    if before_halt == "resuming":
        rig.tick(SLOWEST_TICKS)
        rig.executor.pace(False)
        rig.tick(40)
    else:
        rig.tick(before_halt)
    assert rig.executor.halt()
    assert rig.until_end(1000).reason is StopReason.HALT
    assert not rig.executor.paused
    rig.executor.pace(True)  # late: nothing executes
    rig.tick(10)
    assert rig.executor.state is Mode.HOLDING
    back = make.joint_path(rig.executor.command[0], rig.home, 1.0)
    rig.accept(make.primitive(back, id="C-8.1"))
    assert rig.until_end().reason is StopReason.GOAL  # the next one is not paused


def test_stop_functions_are_checked_during_a_pause(rig, make) -> None:
    rig.accept(swing(rig, make, make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=5.0))))
    rig.tick(800)
    stand(rig)
    rig.arm.wrench = [0.0, 8.0, 0.0, 0.0, 0.0, 0.0]
    assert rig.until_end().reason is StopReason.FORCE_LIMIT


def test_a_time_limit_does_not_count_a_pause(rig, make) -> None:
    rig.accept(swing(rig, make, limit_s=2.9))
    rig.tick(800)
    stand(rig)
    rig.tick(3000)
    rig.executor.pace(False)
    assert rig.until_end().reason is StopReason.GOAL


def test_a_time_limit_counts_again_after_a_pause(rig, make) -> None:
    rig.accept(swing(rig, make, limit_s=1.4))
    rig.tick(800)
    stand(rig)
    rig.executor.pace(False)
    assert rig.until_end().reason is StopReason.TIMEOUT


def test_a_hand_stops_in_a_pause_and_goes_on(rig, make) -> None:
    rig.accept(make.primitive(p.HandMotion(width_m=0.02, force_n=20.0)))
    rig.tick(300)
    rig.executor.pace(True)
    rig.tick(5)
    width = rig.arm.width
    rig.tick(300)
    assert rig.arm.width == pytest.approx(width, abs=1e-3)
    rig.executor.pace(False)
    assert rig.until_end().reason is StopReason.GOAL
    assert rig.arm.width == pytest.approx(0.02, abs=6e-4)


def test_a_hold_is_as_much_longer_as_it_was_paused(rig, make) -> None:
    rig.accept(make.primitive(p.HoldStill(duration_s=0.2)))
    rig.tick(100)
    rig.executor.pace(True)
    rig.tick(1000)
    rig.executor.pace(False)
    assert rig.until_end().duration_s == pytest.approx(1.2, abs=0.03)


def test_the_subsystem_pauses_the_named_primitive_only_and_names_it_in_its_hello(cell, make) -> None:
    from sim_mcm.arms.kinematic_arm import KinematicCell

    bench = make.Bench(KinematicCell(cell))
    home = cell.arm("RIGHT-ARM").home_rad
    path = make.joint_path(home, [home[0] - 0.2, *home[1:]], 1.0)
    bench.handle(m.Execute(primitive=make.primitive(path, id="C-1.1")))
    bench.tick(200)
    bench.handle(m.SetPaused(primitive="C-9.1", paused=True))
    assert bench.subsystem.hello()[0][1].paused == []
    bench.handle(m.SetPaused(primitive="C-1.1", paused=True))
    bench.tick(SLOWEST_TICKS)
    hello = bench.subsystem.hello()[0][1]
    assert RIGID in hello.abilities
    assert (PAUSES in hello.abilities, hello.paused) == (True, ["C-1.1"])
    assert paced(message for _, message in bench.sent) == [True]
