"""The test bench makes things heavier and pads smoother than the RTC counts on."""

from __future__ import annotations

import pybullet
import pytest

from rtc.model.cells.cell import Cell
from sim_mcm.arms.bullet_arm import FINGER_FRICTION, BulletCell
from sim_mcm.arms.kinematic_arm import KinematicCell


@pytest.mark.physics
def test_things_weigh_and_pads_rub_by_factors_of_what_the_cell_says():
    world = BulletCell(Cell.load("swapout"))
    body, client = world.world.objects["MACS-NEW"].id, world.world.client
    for mass, friction in ((1.5, 0.5), (1.0, 1.0)):  # factors of the cell's figures, not of the last ones
        assert world.change_physics(mass, friction) == ""
        kg, _, inertia = pybullet.getDynamicsInfo(body, -1, physicsClientId=client)[:3]
        assert (kg, inertia[0]) == pytest.approx((2.0 * mass, 0.0145 * mass))
        for arm in world.arms.values():
            for finger in arm.fingers:
                rubs = pybullet.getDynamicsInfo(arm.body, finger, physicsClientId=client)[1]
                assert rubs == pytest.approx(friction * FINGER_FRICTION)
    world.close()


def test_exact_arms_refuse_them():
    assert "neither mass nor friction" in KinematicCell(Cell.load("swapout")).change_physics(1.5, 0.5)
