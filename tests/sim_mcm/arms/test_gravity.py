"""A cell with gravity on pybullet: the servo carries arm and load, and the wrist sensor shows contacts only."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from rtc.model.cells.cell import Cell
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry
from sim_mcm.arms.bullet_arm import BulletCell

pytestmark = pytest.mark.physics
ARM, MODULE = "RIGHT-ARM", "MACS-NEW"
LIGHTER = 0.25  # two kilograms, 15 cm before the pads, would turn in the grip on earth


@pytest.fixture(scope="module")
def earth(cell) -> Cell:
    return msgspec.structs.replace(cell, gravity_m_s2=(0.0, 0.0, -9.81))


@pytest.fixture
def world(earth):
    made = BulletCell(earth)
    yield made
    made.close()


@pytest.fixture
def bench(world, make):
    return make.Bench(world)


def soft(stiffness_n_m: float) -> p.ControlLaw:
    figures = [stiffness_n_m] * 3 + [0.03 * stiffness_n_m] * 3
    return p.ControlLaw(name="impedance", compliance=p.Compliance(stiffness=figures))


@pytest.mark.parametrize("law", [p.ControlLaw(), soft(300.0)], ids=["position", "impedance"])
def test_an_arm_under_gravity_neither_sags_nor_feels_its_own_weight(world, bench, make, earth, law) -> None:
    """Through a motion that turns the hand by 60 degrees."""
    model, executor = ArmModel.of(earth, ARM), bench.subsystem.executors[ARM]
    start = executor.command[0]
    goal = [start[0] - 0.3, start[1], start[2], start[3], start[4] - 0.6, start[5] + 1.0]
    worst = [0.0]

    def watch() -> None:
        off = geometry.distance(model.fk(executor.command[0]), model.fk(executor.sample.joints))
        worst[0] = max(worst[0], off)

    guard = make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=3.0))
    report = bench.perform(make.primitive(make.joint_path(start, goal, 2.0), guard, control_law=law), watch=watch)
    assert report.reason is StopReason.GOAL
    assert worst[0] < 0.002
    assert np.linalg.norm(executor.sample.wrench[:3]) < 0.3  # without subtracting a bias
    assert np.linalg.norm(executor.sample.wrench[3:]) < 0.1


def test_a_module_is_lifted_and_held_under_gravity(world, bench, make, earth) -> None:
    world.change_physics(LIGHTER, 1.0)
    model, executor = ArmModel.of(earth, ARM), bench.subsystem.executors[ARM]
    thing = earth.object(MODULE)
    point = thing.grasp_point("HANDLE-A").frame.pose
    handle = geometry.compose(earth.object_pose(MODULE), point)
    count = [0]

    def go(goal, speed_m_s: float = 0.1, law: p.ControlLaw | None = None) -> m.EndReport:
        count[0] += 1
        path = make.line_path(model, executor.command[0], goal, speed_m_s)
        return bench.perform(make.primitive(path, id=f"C-1.{count[0]}", control_law=law or p.ControlLaw()))

    front = geometry.translate(handle, (-0.1, 0.0, 0.0))
    start = executor.command[0]
    path = make.joint_path(start, model.ik(front, near=start)[0].tolist(), 3.0)
    assert bench.perform(make.primitive(path, id="C-2.1")).reason is StopReason.GOAL
    assert go(handle).reason is StopReason.GOAL
    grip = bench.perform(make.primitive(p.HandMotion(width_m=0.0, force_n=55.0), id="C-2.2"))
    assert grip.reason is StopReason.GOAL

    com = geometry.inverse(point)
    inertia = [LIGHTER * n for n in (0.0165, 0.0125, 0.0145)]
    load = p.Load(mass_kg=LIGHTER * thing.mass_kg, com_m=com[:3].tolist(), inertia_kg_m2=[*inertia, 0, 0, 0])
    held = p.ControlLaw(load=load, gains={"wn": 100.0})
    assert go(geometry.translate(handle, (0.0, 0.0, 0.15)), law=held).reason is StopReason.GOAL
    at = world.truth()["poses"][MODULE]
    bench.tick(1000)
    later = world.truth()["poses"][MODULE]
    assert world.held()[ARM] == [MODULE]
    assert geometry.distance(at, later) < 0.001
    assert np.linalg.norm(executor.sample.wrench[:3]) < 0.3
    assert np.linalg.norm(executor.sample.wrench[3:]) < 0.05

    law = msgspec.structs.replace(soft(300.0), load=load, gains={"wn": 100.0})
    bench.perform(make.primitive(p.HoldStill(duration_s=1.0), id="C-3.1", control_law=law))
    assert geometry.distance(world.truth()["poses"][MODULE], later) < 0.003  # it would sag 16 mm without compensation
