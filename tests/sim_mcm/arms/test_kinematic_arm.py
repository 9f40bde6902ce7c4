"""Exact arms in a cell of shapes: what they feel, hold and carry."""

from __future__ import annotations

import numpy as np
import pytest

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry
from sim_mcm.arms.kinematic_arm import KinematicCell, displaced

ARM = "RIGHT-ARM"


@pytest.fixture
def hand_at_handle(cell, make):
    """(bench, model, joints, pose): the right hand, open, `aside` metres off HANDLE-A of the module in RACK-1."""

    def build(aside_m: float = 0.0):
        bench, model = make.Bench(KinematicCell(cell)), ArmModel.of(cell, ARM)
        module = cell.object_pose("MACS-NEW")
        handle = geometry.compose(module, cell.object("MACS-NEW").grasp_point("HANDLE-A").frame.pose)
        pose = geometry.translate(handle, (0.0, aside_m, 0.0))
        joints = model.ik(pose, near=cell.arm(ARM).home_rad)[0]
        arm = bench.simulation.arms[ARM]
        arm.follow((joints.tolist(), [0.0] * 6, [0.0] * 6))
        bench.simulation.step()
        bench.subsystem = type(bench.subsystem)(bench.simulation.arms)
        return bench, model, joints, pose

    return build


def test_in_free_space_nothing_is_felt(cell) -> None:
    world = KinematicCell(cell)
    for _ in range(10):
        world.step()
    assert world.arms[ARM].read().wrench == [0.0] * 6


@pytest.mark.parametrize(("side", "sign"), [(1.0, -1.0), (-1.0, 1.0)])
def test_a_guarded_move_finds_the_handle_from_either_side(hand_at_handle, make, side: float, sign: float) -> None:
    bench, model, joints, pose = hand_at_handle()
    goal = geometry.translate(pose, (0.0, 0.045 * side, 0.0))
    feel = make.stop(StopReason.CONTACT, p.ForceAbove(limit_n=5.0))

    report = bench.perform(make.primitive(make.line_path(model, joints, goal, 0.02), feel))

    # a finger's pad is 40 mm from the middle of the open hand, the handle is 20 mm thick: it touches after 30 mm
    assert report.reason is StopReason.CONTACT
    assert report.trip_pose[1] - pose[1] == pytest.approx(0.030 * side, abs=0.0002)
    assert report.trip_wrench[1] * sign > 5.0
    assert np.linalg.norm(report.wrench[:3]) < 0.5  # it does not lean on it


def test_fingers_close_on_the_handle_press_and_carry_it(hand_at_handle, make) -> None:
    bench, model, joints, pose = hand_at_handle(aside_m=0.002)
    world = bench.simulation

    report = bench.perform(make.primitive(p.HandMotion(width_m=0.0, force_n=30.0)))
    assert report.reason is StopReason.GOAL
    assert report.hand_width_m == pytest.approx(0.020, abs=0.0002)
    assert report.hand_force_n == pytest.approx(30.0, rel=0.06)  # a grip is complete at 95 %
    assert world.held() == {ARM: ["MACS-NEW"], "LEFT-ARM": []}

    before = world.truth()["poses"]["MACS-NEW"]
    up = geometry.translate(pose, (0.0, 0.0, 0.1))
    bench.perform(make.primitive(make.line_path(model, joints, up, 0.1), id="C-7.2"))
    after = world.truth()["poses"]["MACS-NEW"]
    assert np.array(after[:3]) - before[:3] == pytest.approx([0.0, 0.0, 0.1], abs=1e-6)

    bench.perform(make.primitive(p.HandMotion(width_m=0.08, force_n=30.0), id="C-7.3"))
    assert world.held()[ARM] == []
    assert world.truth()["poses"]["MACS-NEW"] == after


def test_a_hand_needs_as_long_for_its_force_as_with_physics(hand_at_handle, make) -> None:
    """6.7 ms a newton, to build it up and to take it away (docs/physics.md); each GRASP took less than foretold."""
    lasted: dict[float, list[float]] = {}
    for force_n in (10.0, 40.0):
        bench, *_ = hand_at_handle()
        motions = [p.HandMotion(width_m=width_m, force_n=force_n, speed_m_s=0.05) for width_m in (0.0, 0.08)]
        reports = [bench.perform(make.primitive(one, id=f"C-7.{n}")) for n, one in enumerate(motions)]
        assert [one.reason for one in reports] == [StopReason.GOAL, StopReason.GOAL]
        lasted[force_n] = [one.duration_s for one in reports]
    for weak_s, firm_s in zip(lasted[10.0], lasted[40.0], strict=True):
        assert firm_s - weak_s == pytest.approx(30.0 * 0.0067, abs=0.02)


def test_an_empty_hand_closes_all_the_way(cell, make) -> None:
    bench = make.Bench(KinematicCell(cell))
    report = bench.perform(make.primitive(p.HandMotion(width_m=0.0, force_n=30.0)))
    assert report.hand_width_m == pytest.approx(0.0, abs=0.0006)
    assert report.hand_force_n == 0.0
    assert bench.simulation.held()[ARM] == []


def test_a_fixed_thing_is_pressed_but_not_carried_off(cell, make, hand_at_handle) -> None:
    bench, *_ = hand_at_handle()
    bench.simulation.fixed.add("MACS-NEW")
    report = bench.perform(make.primitive(p.HandMotion(width_m=0.0, force_n=30.0)))
    assert report.hand_width_m == pytest.approx(0.020, abs=0.0002)
    assert bench.simulation.held()[ARM] == []


def test_displacing_moves_a_module_with_its_seat(cell, make, hand_at_handle) -> None:
    bench, model, joints, pose = hand_at_handle()
    world = bench.simulation
    assert world.displace("MACS-NEW", [0.0, 0.005, 0.0, 0.0, 0.0, 0.0]) == ""
    assert world.displace("NOTHING", [0.0] * 6).startswith("there is no object or seat NOTHING; ")

    goal = geometry.translate(pose, (0.0, 0.045, 0.0))
    feel = make.stop(StopReason.CONTACT, p.ForceAbove(limit_n=5.0))
    report = bench.perform(make.primitive(make.line_path(model, joints, goal, 0.02), feel))
    assert report.trip_pose[1] - pose[1] == pytest.approx(0.035, abs=0.0002)
    assert world.poses["RACK-1"][1] == pytest.approx(cell.seat("RACK-1").frame.pose[1] + 0.005)


def test_what_is_held_is_not_displaced(make, hand_at_handle) -> None:
    bench, *_ = hand_at_handle()
    bench.perform(make.primitive(p.HandMotion(width_m=0.0, force_n=30.0)))
    assert bench.simulation.displace("MACS-NEW", [0.01, 0, 0, 0, 0, 0]) == "MACS-NEW is held by RIGHT-ARM"


def test_many_small_displacements_keep_a_pose_a_pose(cell) -> None:
    world = KinematicCell(cell)
    for _ in range(200):
        assert world.displace("MACS-NEW", [0.0, 0.0, 0.0, 0.001, 0.0, 0.001]) == ""
    for name in ("MACS-NEW", "RACK-1"):
        assert np.linalg.norm(world.poses[name][3:]) == pytest.approx(1.0)


def test_a_displacement_turns_about_the_origin_of_the_thing() -> None:
    pose = geometry.make_pose((1.0, 2.0, 3.0))
    moved = displaced(pose, [0.1, 0.0, 0.0, 0.0, 0.0, np.pi / 2])
    assert moved[:3] == pytest.approx([1.1, 2.0, 3.0])
    assert geometry.rotate(moved, (1.0, 0.0, 0.0)) == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
