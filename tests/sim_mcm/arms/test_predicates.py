"""Stop functions in physics that no sentence brings about by itself: each ends a primitive, and is named."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace

import pybullet
import pytest

from rtc.protocol import primitive as p
from rtc.protocol.messages import EndReport
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry
from rtc.subsystems.motion.arm import HandCommand
from sim_mcm.arms.bullet_arm import BulletCell

pytestmark = pytest.mark.physics
ARM, MODULE, OTHER = "RIGHT-ARM", "MACS-NEW", "MACS-OLD"
FOREARM = 3  # link of the URDF


@pytest.fixture(scope="module")
def world(cell) -> Iterator[BulletCell]:
    made = BulletCell(cell)
    yield made
    made.close()


@pytest.fixture
def perform(world, make) -> Callable[..., EndReport]:
    bench = make.Bench(world)
    primitives = iter(range(1, 9))

    def execute(trajectory: p.Trajectory, reason: StopReason, when: p.Predicate) -> EndReport:
        wanted = make.primitive(trajectory, make.stop(reason, when), id=f"C-1.{next(primitives)}", limit_s=4.0)
        report: EndReport = bench.perform(wanted)
        return report

    return execute


@pytest.fixture
def turn(world, make) -> Callable[[float, float], p.JointTrajectory]:
    """A path that turns the last joint by an angle (rad) within a time (s)."""

    def path(by_rad: float, duration_s: float) -> p.JointTrajectory:
        here = list(world.arms[ARM].read().joints)
        made: p.JointTrajectory = make.joint_path(here, [*here[:-1], here[-1] + by_rad], duration_s)
        return made

    return path


def test_a_joint_that_comes_near_its_limit(world, perform, turn) -> None:
    highest = world.arms[ARM].traits.upper[-1]
    way = turn(highest - 0.05 - world.arms[ARM].read().joints[-1], 3.0)
    report = perform(way, StopReason.JOINT_LIMIT, p.JointMarginBelow(0.1))
    assert report.reason is StopReason.JOINT_LIMIT
    assert report.message.startswith("joint_6 ")  # wording: the joint that is named
    assert 0.05 < highest - report.joints[-1] < 0.1


def test_a_joint_that_is_too_fast(perform, turn) -> None:
    report = perform(turn(-1.0, 1.0), StopReason.OVERSPEED, p.SpeedAbove(0.3))
    assert report.reason is StopReason.OVERSPEED
    assert report.message.startswith("joint_6 ")  # wording: the joint that is named
    assert report.measured == pytest.approx(report.limit, rel=0.05)


def test_a_hand_that_closes_on_nothing(perform) -> None:
    report = perform(p.HandMotion(width_m=0.0, force_n=20.0), StopReason.OBJECT_LOST, p.HandWidthBelow(0.05))
    assert report.reason is StopReason.OBJECT_LOST
    assert report.hand_width_m == pytest.approx(0.05, abs=0.002)
    assert report.duration_s == pytest.approx(0.6, abs=0.1)  # 3 cm with the default speed of 5 cm/s


def test_a_grip_that_becomes_weaker(cell, world, perform) -> None:
    arm, point = world.arms[ARM], cell.object(OTHER).grasp_point("HANDLE-A").frame.pose
    assert not world.displace("SATELLITE", [0.5, 0.0, 0.0, 0.0, 0.0, 0.0])  # it would be in the way of the module
    world._detents.let_go(OTHER)
    between_fingers = geometry.compose(arm.tcp_pose(arm.read().joints), geometry.inverse(point))
    world.world.place(world.world.objects[OTHER], between_fingers)
    slip = (StopReason.SLIP, p.GripForceBelow(10.0))
    closed = perform(p.HandMotion(width_m=0.0, force_n=20.0), StopReason.OBJECT_LOST, p.HandWidthBelow(0.01))
    assert closed.reason is StopReason.GOAL
    assert perform(p.HoldStill(duration_s=0.1), *slip).reason is StopReason.GOAL
    arm.command_hand(HandCommand(0.0, 5.0, 0.05))
    report = perform(p.HoldStill(duration_s=1.0), *slip)
    assert report.reason is StopReason.SLIP
    assert report.measured == pytest.approx(5.0, abs=0.5)


def test_a_body_that_touches_a_link(world, perform) -> None:
    """A module drifts from above onto the forearm, which holds still."""
    client, module = world.world.client, world.world.objects[MODULE]
    body = SimpleNamespace(arm=world.arms[ARM].body, module=module.id)
    low, high = pybullet.getAABB(body.arm, FOREARM, physicsClientId=client)
    world._detents.let_go(MODULE)
    world.world.place(module, geometry.make_pose((0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), high[2] + 0.2)))
    pybullet.resetBaseVelocity(body.module, [0.0, 0.0, -0.15], physicsClientId=client)
    report = perform(p.HoldStill(duration_s=3.0), StopReason.COLLISION, p.BodyTouch())
    assert report.reason is StopReason.COLLISION
    assert report.message.endswith(f" touches {MODULE}")  # wording: the body that is named
