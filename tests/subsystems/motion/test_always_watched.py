"""What the executor watches in every primitive: its own commands, the following error, the speed, and rest."""

from __future__ import annotations

import numpy as np
import pytest

from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.subsystems.motion.arm import TICK_S
from rtc.subsystems.motion.modes import Mode


class _Leap:
    """A profile with an error in it: it is a radian away from one tick to the next."""

    duration_s = 1.0

    def __init__(self, joints) -> None:
        self._joints = joints

    def at(self, time_s: float):
        far = 1.0 if time_s > 0.1 else 0.0
        return [self._joints[0] + far, *self._joints[1:]], [0.0] * 6, [0.0] * 6


@pytest.mark.parametrize("value", ["leap", "nan"])
def test_a_command_beyond_the_limits_is_not_followed_and_ends_the_primitive(rig, value: str) -> None:
    rig.accept(rig.swing())
    rig.tick(300)
    leap = _Leap(rig.arm.motion[0] if value == "leap" else [float("nan")] * 6)
    rig.executor._setpoints.use(leap)

    report = rig.until_end()

    assert report.reason is StopReason.COMMAND_LIMIT
    assert report.limit == pytest.approx(1.25 * rig.arm.traits.velocity[0])
    steps = np.abs(np.diff([motion[0] for motion in rig.arm.commands], axis=0))
    assert np.all(steps <= 1.25 * np.array(rig.arm.traits.velocity) * TICK_S)
    assert rig.executor.state is Mode.HOLDING


def test_a_leap_while_it_stops_is_braked_and_the_reason_stands(rig, make) -> None:
    rig.accept(rig.swing(make.stop(StopReason.CONTACT, p.ForceAbove(limit_n=5.0))))
    rig.tick(500)
    rig.arm.wrench = [6.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    rig.tick(2)
    assert rig.executor.state is Mode.STOPPING
    setpoints = rig.executor._setpoints
    setpoints.profile, setpoints.ticks = _Leap(rig.arm.motion[0]), 200
    rig.arm.wrench = [0.0] * 6
    assert rig.until_end().reason is StopReason.CONTACT
    steps = np.abs(np.diff([motion[0] for motion in rig.arm.commands], axis=0))
    assert np.all(steps <= 1.25 * np.array(rig.arm.traits.velocity) * TICK_S)


def test_an_arm_that_does_not_follow_is_stopped_for_that(rig) -> None:
    rig.accept(rig.swing())
    rig.tick(300)
    rig.arm.lag = 0.25
    report = rig.until_end()
    assert report.reason is StopReason.FOLLOWING_ERROR
    assert report.measured == pytest.approx(0.25)
    assert "joint_1 is -14.3 deg from where it is commanded to be" in report.message  # wording: the joint


def test_an_arm_that_runs_away_is_stopped_for_that(rig, make) -> None:
    read = rig.arm.read
    rig.accept(make.primitive(p.HoldStill(duration_s=5.0)))
    rig.tick(10)
    rig.arm.read = lambda: m_replace(read(), [0.0, 0.0, 0.0, 0.0, 0.0, 7.0])
    report = rig.until_end()
    assert report.reason is StopReason.OVERSPEED
    assert "joint_6 turns at 7.00 rad/s" in report.message  # wording: the joint


def m_replace(sample, velocities):
    sample.velocities = velocities
    return sample


@pytest.mark.parametrize("swing_rad_s", [0.0075, 0.06])
def test_chatter_of_the_wrist_is_rest(rig, swing_rad_s: float) -> None:
    """A speed that alternates from tick to tick, with which nothing goes anywhere."""
    ticks = [0]
    read = rig.arm.read

    def chattering():
        ticks[0] += 1
        sample, way = read(), (-1) ** ticks[0]
        sample.velocities = [*sample.velocities[:5], sample.velocities[5] + way * swing_rad_s]
        sample.joints = [*sample.joints[:5], sample.joints[5] + 0.5 * way * swing_rad_s * TICK_S]
        return sample

    rig.arm.read = chattering
    rig.accept(rig.swing(limit_s=2.0))
    report = rig.until_end()
    assert report.reason is StopReason.GOAL
    assert report.duration_s < 1.1
    assert rig.executor.at_rest


def test_a_swing_is_no_rest(rig) -> None:
    """Two Hz, 20 mrad: the arm is where it was commanded to be twice in every swing."""
    ticks = [0]
    read = rig.arm.read

    def swinging():
        ticks[0] += 1
        sample = read()
        sample.joints = [*sample.joints[:5], sample.joints[5] + 0.02 * np.sin(4.0 * np.pi * ticks[0] * TICK_S)]
        return sample

    rig.arm.read = swinging
    rig.accept(rig.swing(limit_s=2.0))
    assert rig.until_end().reason is StopReason.TIMEOUT
    assert not rig.executor.at_rest
