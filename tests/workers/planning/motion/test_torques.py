"""A motion keeps within the joints' torques with its load, and a load that is too heavy is refused."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import causes
from rtc.protocol.primitive import Load
from tests.workers.refusals import refusal_of
from workers.planning.motion.path import joint_line, task_line, through
from workers.planning.motion.timing import SpeedLimits, time_path
from workers.planning.motion.torques import SHARE

HEAVY_KG = 99.0
BRISK = SpeedLimits(speed_m_s=1.0, acceleration_m_s2=5.0)


def load(mass_kg):
    own = 0.01 * mass_kg
    return Load(mass_kg=mass_kg, com_m=[0.0, 0.0, 0.15], inertia_kg_m2=[own, own, own, 0.0, 0.0, 0.0])


def paths(arm, home):
    start = np.array(home["RIGHT-ARM"])
    goal = start + np.array([-1.2, -0.5, 0.4, 0.3, 0.2, -0.4])
    pose = arm.fk(start) + np.array([0.0, -0.15, -0.2, 0, 0, 0, 0])
    return {
        "line in joint space": joint_line(start, goal),
        "line of the hand": task_line(arm, start, pose),
        "rounded corners": through([start, start + np.array([-0.3, -0.4, 0.3, 0.0, 0.3, 0.0]), goal]),
    }


def greatest_share(arm, timed, carried):
    """Of the joints' effort, at the knots."""
    laden = arm.laden(carried.mass_kg, carried.com_m, carried.inertia_kg_m2)
    torques = arm.torques(timed.positions, timed.velocities, timed.accelerations, laden)
    return float((np.abs(torques) / arm.limits.effort).max())


@pytest.mark.parametrize("name", ["line in joint space", "line of the hand", "rounded corners"])
def test_a_heavy_load_is_moved_more_slowly_within_the_torques(right, home, name):
    path = paths(right, home)[name]
    light, heavy = (time_path(right, path, BRISK, load(mass_kg)) for mass_kg in (0.5, HEAVY_KG))
    empty = time_path(right, path, BRISK)
    assert light.duration_s == empty.duration_s
    assert heavy.duration_s > 1.1 * light.duration_s
    assert greatest_share(right, empty, load(HEAVY_KG)) > 1.2
    assert 0.5 * SHARE < greatest_share(right, heavy, load(HEAVY_KG)) <= SHARE * 1.001


@pytest.fixture
def weighed(cell):
    """The arm under the gravity of the earth."""
    return ArmModel.of(msgspec.structs.replace(cell, gravity_m_s2=[0.0, 0.0, -9.81]), "RIGHT-ARM")


def test_a_load_whose_weight_a_joint_cannot_hold_is_refused_with_the_joint(weighed, home):
    path = paths(weighed, home)["line of the hand"]
    refusal = refusal_of(time_path, weighed, path, load=load(60.0))
    assert isinstance(refusal.cause, causes.JointTorqueExceeded)
    assert refusal.cause.joint in weighed.joints
    assert abs(refusal.cause.torque_nm) > refusal.cause.limit_nm
    assert 0 <= refusal.fraction <= 1


def test_weight_and_motion_together_keep_within_the_torques(weighed, home):
    """The weight takes a share of the torque that is not the same in both directions."""
    path = paths(weighed, home)["line in joint space"]
    timed = time_path(weighed, path, BRISK, load(4.0))
    assert timed.duration_s >= time_path(weighed, path, BRISK).duration_s
    assert greatest_share(weighed, timed, load(4.0)) <= SHARE * 1.001
