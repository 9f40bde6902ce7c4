"""What outlives its controller."""

from __future__ import annotations

import pytest

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import primitive as p
from rtc.spatial import geometry
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.arms.kinematic_arm import KinematicCell
from sim_mcm.state_file import FILE, StateFile

ARM, MODULE = "RIGHT-ARM", "MACS-NEW"
SIMULATIONS = [(KinematicCell, 1e-9), pytest.param(BulletCell, 1e-3, marks=pytest.mark.physics)]


@pytest.fixture
def memory(tmp_path):
    return lambda run: StateFile(tmp_path, run, "MCM")


@pytest.mark.parametrize(("simulation", "tolerance_m"), SIMULATIONS)
def test_a_module_in_the_hand_is_in_the_hand_of_the_next_process_too(cell, make, memory, simulation, tolerance_m):
    # Given a module gripped and lifted
    bench, model = make.Bench(simulation(cell)), ArmModel.of(cell, ARM)
    handle = geometry.compose(cell.object_pose(MODULE), cell.object(MODULE).grasp_point("HANDLE-A").frame.pose)
    before = geometry.compose(handle, (0.0, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0))
    home = list(cell.arm(ARM).home_rad)
    there = model.ik(before, near=home)[0].tolist()
    ways = [
        make.joint_path(home, there, 2.5),
        make.line_path(model, there, handle, 0.1),
        p.HandMotion(width_m=0.0, force_n=30.0),
    ]
    for n, way in enumerate(ways, 1):
        bench.perform(make.primitive(way, id=f"C-1.{n}"))
    up = geometry.translate(handle, (0.0, 0.0, 0.1))
    start = bench.subsystem.executors[ARM].command[0]
    bench.perform(make.primitive(make.line_path(model, start, up, 0.1), id="C-1.4"))
    truth = bench.simulation.truth()

    # When its controller dies, and another process begins with what was kept
    memory("run 1").save(bench.simulation.state())
    successor = simulation(cell)
    successor.restore(memory("run 1").load())
    bench = make.Bench(successor)
    bench.perform(make.primitive(p.HoldStill(duration_s=0.5), id="C-2.1"))

    # Then all is where it was, and it can be carried on
    found = successor.truth()
    assert found["joints"][ARM] == pytest.approx(truth["joints"][ARM], abs=2e-4)
    assert geometry.distance(found["poses"][MODULE], truth["poses"][MODULE]) <= tolerance_m
    assert successor.held() == {ARM: [MODULE], "LEFT-ARM": []}
    start = bench.subsystem.executors[ARM].command[0]
    bench.perform(make.primitive(make.line_path(model, start, handle, 0.1), id="C-2.2"))
    assert geometry.distance(successor.truth()["poses"][MODULE], cell.object_pose(MODULE)) <= 2 * tolerance_m
    assert successor.held()[ARM] == [MODULE]


def test_a_new_run_begins_anew(cell, memory):
    memory("run 1").save(KinematicCell(cell).state())
    assert memory("run 2").load() is None


def test_a_shorter_state_after_a_longer_one_is_whole(cell, memory):
    state = KinematicCell(cell).state()
    memory("run 1").save(state)
    state.poses = {}
    memory("run 1").save(state)
    assert memory("run 1").load() == state


@pytest.mark.parametrize("left", [b"", b"mine", b"\x02\0\0\0\x92\xa1", b"\x04\0\0\0\x92\xa1a\xc0"])
def test_what_is_no_state_of_ours_is_nothing(memory, tmp_path, left):
    (tmp_path / FILE.format("MCM")).write_bytes(left)
    assert memory("a").load() is None
