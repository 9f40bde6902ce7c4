"""The wrench at the tcp from joint torques, on exact rigid-body dynamics without physics."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from rtc.model.cells.cell import Cell
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.primitive import Load
from rtc.subsystems.motion.arm import TICK_S
from sim_mcm.arms.joint_torques import JointTorques

WRENCH = np.array([4.0, -3.0, 12.0, 0.2, 0.5, -0.3])  # tool axes


@pytest.fixture(scope="module")
def panda() -> ArmModel:
    return ArmModel.of(Cell.load("panda"), "PANDA")


def estimated(arm: ArmModel, wrench: np.ndarray, load: Load | None, known: bool, ticks: int = 60) -> np.ndarray:
    """The estimate after some ticks of a moving arm on which a wrench acts, with a load that it knows or does not."""
    q, v = np.array(Cell.load("panda").arm("PANDA").home_rad), np.full(7, 0.1)
    truth = arm.model if load is None else arm.laden(load.mass_kg, load.com_m, load.inertia_kg_m2)
    data, estimate = truth.createData(), JointTorques(arm)
    if known:
        estimate.carry(load)
    found = np.zeros(6)
    for _ in range(ticks):
        torques = pin.rnea(truth, data, q, v, np.full(7, 0.5))
        jacobian = pin.computeFrameJacobian(truth, data, q, arm.tcp_frame, pin.LOCAL)
        acceleration = pin.aba(truth, data, q, v, torques + jacobian.T @ wrench)
        estimate.drive(torques.tolist())
        v = v + TICK_S * acceleration
        q = q + TICK_S * v
        found = np.array(estimate.wrench(q.tolist(), v.tolist()))
        assert np.array_equal(estimate.wrench(q.tolist(), v.tolist()), found)  # a second look within the tick
    return found


def test_a_wrench_on_the_hand_is_measured(panda):
    assert estimated(panda, WRENCH, None, False) == pytest.approx(WRENCH, rel=0.05, abs=0.1)


def test_motion_alone_is_no_contact(panda):
    assert np.abs(estimated(panda, np.zeros(6), None, False)).max() < 1e-6


def test_a_known_load_is_no_contact_and_an_unknown_one_is(panda):
    load = Load(mass_kg=1.0, com_m=[0.0, 0.0, 0.03], inertia_kg_m2=[1e-3, 1e-3, 1e-3, 0.0, 0.0, 0.0])
    assert np.abs(estimated(panda, np.zeros(6), load, True)).max() < 1e-6
    assert np.linalg.norm(estimated(panda, np.zeros(6), load, False)[:3]) == pytest.approx(9.81, rel=0.2)


def test_after_a_reset_the_past_is_forgotten(panda):
    estimate = JointTorques(panda)
    q, still = panda.middle.tolist(), [0.0] * 7
    estimate.wrench(q, still)
    estimate.drive([50.0] * 7)
    assert np.abs(estimate.wrench(q, still)).max() > 1.0
    estimate.begin()
    assert np.abs(estimate.wrench(q, still)).max() == 0.0
