"""Objects with a hinge in the simulated cells: friction, stops, what a hand does to them, and what is saved."""

from __future__ import annotations

import math

import numpy as np
import pybullet
import pytest

from rtc.model.cells.cell import Cell
from rtc.model.robot.kinematics import ArmModel
from rtc.spatial import geometry, hinges
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.arms.bullet_world import HINGED, PhysicsWorld
from sim_mcm.arms.kinematic_arm import KinematicCell

CELL = Cell.load("servicing")
DOOR, ARM = "DOOR-2", "LEFT-ARM"
HINGE, HOME = CELL.object(DOOR).hinge, CELL.object(DOOR).frame.pose


@pytest.fixture
def world():
    made = PhysicsWorld(CELL)
    yield made
    made.close()


def turn(world: PhysicsWorld, torque_nm: float, steps: int) -> float:
    """Turn the door with a torque about its axis; returns its angle (deg)."""
    door, client = world.objects[DOOR].id, world.client
    for _ in range(steps):
        torque = [torque_nm * n for n in HINGE.axis]
        pybullet.applyExternalTorque(door, HINGED, torque, pybullet.WORLD_FRAME, physicsClientId=client)
        world.step()
    return math.degrees(world.angle(DOOR))


@pytest.mark.physics
def test_a_door_yields_to_more_than_its_friction_and_ends_at_its_stop(world) -> None:
    assert turn(world, 0.9, 300) == pytest.approx(0.0, abs=0.01)
    opened = turn(world, 1.3, 300)
    assert 3.0 < opened < 60.0
    rests = turn(world, 0.0, 700)
    assert turn(world, 0.0, 200) == pytest.approx(rests, abs=1e-3)  # and stays where it is
    assert turn(world, 2.0, 1200) == pytest.approx(HINGE.range_deg[1], abs=0.1)
    pose = hinges.turned(HOME, HINGE.axis, world.angle(DOOR))
    assert np.allclose(world.pose(DOOR), pose, atol=1e-9)
    state = pybullet.getLinkState(world.objects[DOOR].id, HINGED, physicsClientId=world.client)
    assert geometry.angle(geometry.make_pose((0, 0, 0), state[5]), pose) < 1e-3


@pytest.mark.physics
def test_the_angle_of_a_door_is_saved_and_restored() -> None:
    cell = BulletCell(CELL)
    opened = hinges.turned(HOME, HINGE.axis, 0.7)
    cell.world.place(cell.world.objects[DOOR], opened)
    state = cell.state()
    cell.world.place(cell.world.objects[DOOR], HOME)
    cell.restore(state)
    assert cell.world.angle(DOOR) == pytest.approx(0.7, abs=1e-6)
    assert np.allclose(cell.truth()["poses"][DOOR], opened, atol=1e-6)
    cell.close()


def test_a_displaced_door_takes_its_hinge_along() -> None:
    cell = KinematicCell(CELL)
    assert cell.displace(DOOR, [0.01, 0.0, 0.0, 0.0, 0.0, -0.5]) == ""
    assert np.allclose(cell.poses[DOOR][:3], [HOME[0] + 0.01, *HOME[1:3]])
    state = cell.state()
    other = KinematicCell(CELL)
    other.restore(state)
    assert np.allclose(other.poses[DOOR], cell.poses[DOOR])
    assert np.allclose(other._homes[DOOR], geometry.translate(HOME, (0.01, 0.0, 0.0)))


def test_a_door_follows_the_exact_hand_that_holds_it_about_its_hinge() -> None:
    cell = KinematicCell(CELL)
    bar = CELL.object(DOOR).grasp_points[0].frame
    tcp = geometry.compose(HOME, bar.pose)
    arm = cell.arms[ARM]
    cell.carried[DOOR] = (ARM, geometry.relative(tcp, HOME))
    for angle in (0.2, 0.8, 1.5):
        where = geometry.transform_point(hinges.turned(HOME, HINGE.axis, angle), bar.xyz)
        joints = ArmModel.of(CELL, ARM).ik(geometry.make_pose(where, tcp[3:]), near=arm.joints)[0].tolist()
        arm.follow((joints, [0.0] * 6, [0.0] * 6))
        cell.step()
        assert hinges.angle_of(HOME, HINGE.axis, cell.poses[DOOR]) == pytest.approx(angle)


@pytest.mark.parametrize("make", [KinematicCell, pytest.param(BulletCell, marks=pytest.mark.physics)])
def test_a_displaced_satellite_takes_along_what_is_mounted_on_it_and_is_restored_there(make) -> None:
    """The door stays at its angle: its hinge has moved. So it does when the state is restored."""
    cell = make(CELL)
    opened = hinges.turned(HOME, HINGE.axis, 0.7)
    assert not cell.displace(DOOR, [*(opened[:3] - HOME[:3]), *geometry.to_rpy(opened)])
    before = cell.truth()
    assert not cell.displace("SATELLITE", [0.005, -0.004, 0.003, 0.01, -0.02, 0.03])
    after = cell.truth()
    moved = geometry.compose(after["poses"]["SATELLITE"], geometry.inverse(before["poses"]["SATELLITE"]))
    along = {DOOR, "BOLT-1", "BOLT-2", "MACS-OLD", "SATELLITE"}
    for name, pose in before["poses"].items():
        expected = geometry.compose(moved, pose) if name in along else pose
        assert np.allclose(after["poses"][name], expected, atol=1e-6), name
    assert np.allclose(after["seats"]["BAY-2"], geometry.compose(moved, before["seats"]["BAY-2"]), atol=1e-9)
    assert after["seats"]["RACK-1"] == before["seats"]["RACK-1"]

    other = make(CELL)
    other.restore(cell.state())
    home = geometry.compose(moved, HOME)
    for one in (cell, other):
        assert np.allclose(one.truth()["poses"]["SATELLITE"], after["poses"]["SATELLITE"], atol=1e-9)
        assert hinges.angle_of(home, HINGE.axis, one.truth()["poses"][DOOR]) == pytest.approx(0.7, abs=1e-6)
        hung = one.world.objects[DOOR].home if make is BulletCell else one._homes[DOOR]
        assert np.allclose(hung, home, atol=1e-9)


def test_a_satellite_whose_door_is_in_a_hand_is_not_displaced() -> None:
    cell = KinematicCell(CELL)
    cell.carried[DOOR] = (ARM, HOME)
    assert cell.displace("SATELLITE", [0.01, 0.0, 0.0, 0.0, 0.0, 0.0]) == f"{DOOR} is held by {ARM}"
