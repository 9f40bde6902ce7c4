"""An arm with a coupler takes hands up and lays them down: with physics, and exactly."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.arms.kinematic_arm import KinematicCell
from sim_mcm.state_file import StateFile
from tests.plugins.tool_changer.cells import FIGURES, with_hands

ARM, HAND, OTHER = "RIGHT-ARM", "HAND-A", "HAND-B"
CELL = with_hands()
SIMULATIONS = [KinematicCell, pytest.param(BulletCell, marks=pytest.mark.physics)]
REACHED_M = 1e-3


def at(hand: str, aside_m: float = 0.0):
    """The joint values at which the coupler is at a hand in its rack, or beside it."""
    point = geometry.compose(CELL.object_pose(hand), CELL.object(hand).grasp_point("COUPLING").frame.pose)
    there = geometry.translate(point, (0.0, 0.0, aside_m))
    return ArmModel.of(CELL, ARM).ik(there, near=CELL.arm(ARM).home_rad)[0].tolist()


def placed(simulation, joints):
    """The simulation with the right arm at rest at these joint values."""
    state = simulation.state()
    state.arms[ARM] = msgspec.structs.replace(state.arms[ARM], joints=joints)
    simulation.restore(state)
    return simulation


@pytest.fixture(params=SIMULATIONS)
def bench_at(request, make):
    """`bench_at(joints)`: arms of either kind, the right one at these joint values."""
    return lambda joints: make.Bench(placed(request.param(CELL), joints))


def couple(bench, hand: str, number: int, planned_with: str = "") -> m.EndReport:
    stops = [
        p.StopFunction(reason=StopReason.GOAL, when=p.GoalReached()),
        p.StopFunction(reason=StopReason.TIMEOUT, when=p.TimeAbove(limit_s=3.0)),
    ]
    return bench.perform(
        p.Primitive(
            id=f"C-1.{number}",
            performer=ARM,
            trajectory=p.Coupling(hand=hand),
            stop_functions=stops,
            hand=planned_with,
        )
    )


def go(bench, make, joints, number: int, hand: str = "") -> m.EndReport:
    here = bench.simulation.arms[ARM].read().joints
    path = make.joint_path(here, joints, 2.0)
    return bench.perform(make.primitive(path, id=f"C-1.{number}", hand=hand))


def test_a_hand_within_reach_is_locked_and_moves_with_the_arm(bench_at, make):
    bench = bench_at(at(HAND))
    before = bench.simulation.truth()["poses"][HAND]
    tcp_m = FIGURES[HAND][2]

    report = couple(bench, HAND, 1)

    assert (report.reason, report.hand) == (StopReason.GOAL, HAND)
    there = geometry.compose(before, (0.0, 0.0, tcp_m - 0.070, 0.0, 0.0, 0.0, 1.0))
    assert geometry.distance(report.tcp_pose, there) < REACHED_M  # the tcp is that of the hand
    home = list(CELL.arm(ARM).home_rad)
    moved = go(bench, make, home, 2, HAND)
    assert (moved.reason, moved.hand) == (StopReason.GOAL, HAND)
    now = bench.simulation.truth()["poses"][HAND]
    offset = geometry.relative(moved.tcp_pose, now)
    assert np.allclose(offset[:3], (0.0, 0.0, 0.070 - tcp_m), atol=REACHED_M)
    assert geometry.distance(before, now) > 0.1
    assert moved.hand_width_m == pytest.approx(FIGURES[HAND][4], abs=REACHED_M)


def test_a_hand_out_of_reach_is_not_locked(bench_at):
    bench = bench_at(at(HAND, aside_m=0.005))

    report = couple(bench, HAND, 1)

    assert (report.reason, report.hand) == (StopReason.NO_CONTACT, "")
    assert bench.simulation.arms[ARM].traits.max_opening_m == CELL.arm(ARM).gripper.max_opening_m


def test_another_hand_than_the_one_there_is_not_locked(bench_at):
    bench = bench_at(at(HAND))

    report = couple(bench, OTHER, 1)

    assert (report.reason, report.hand) == (StopReason.NO_CONTACT, "")


def test_a_hand_that_is_let_go_of_stays_in_its_rack_and_another_one_is_taken(bench_at, make):
    bench = bench_at(at(HAND))
    assert couple(bench, HAND, 1).hand == HAND
    report = couple(bench, "", 2, HAND)
    assert (report.reason, report.hand) == (StopReason.GOAL, "")
    assert geometry.distance(report.tcp_pose, ArmModel.of(CELL, ARM).fk(at(HAND))) < REACHED_M
    opened = bench.perform(make.primitive(p.HandMotion(width_m=0.05, force_n=20.0), id="C-1.3", hand=""))
    assert opened.reason is StopReason.GOAL
    placed(bench.simulation, at(OTHER))  # what the way there is does not matter here
    bench = make.Bench(bench.simulation)

    report = couple(bench, OTHER, 4)

    assert (report.reason, report.hand) == (StopReason.GOAL, OTHER)
    lies = bench.simulation.truth()["poses"][HAND]
    assert geometry.distance(lies, CELL.object_pose(HAND)) < REACHED_M
    assert bench.simulation.arms[ARM].traits.max_grip_n == FIGURES[OTHER][5]


def test_a_motion_that_was_planned_with_another_hand_is_refused(bench_at, make):
    bench = bench_at(at(HAND))
    couple(bench, HAND, 1)

    report = go(bench, make, list(CELL.arm(ARM).home_rad), 2, OTHER)

    assert (report.reason, report.hand) == (StopReason.REFUSED, HAND)


def test_a_second_arm_that_was_planned_with_another_hand_is_refused(bench_at, make):
    bench = bench_at(at(HAND))
    paths = {
        name: make.joint_path(arm.read().joints, arm.read().joints, 1.0) for name, arm in bench.simulation.arms.items()
    }
    second = p.Partner(
        performer=ARM,
        trajectory=paths[ARM],
        control_law=p.ControlLaw(),
        stop_functions=make.complete(),
        hand=HAND,
    )

    report = bench.perform(make.primitive(paths["LEFT-ARM"], performer="LEFT-ARM", partner=second))

    assert report.reason is StopReason.REFUSED


def test_a_halt_before_the_coupler_locks_leaves_all_as_it_was(bench_at, make):
    bench = bench_at(at(HAND))
    order = p.Primitive(
        id="C-1.1",
        performer=ARM,
        trajectory=p.Coupling(hand=HAND),
        stop_functions=make.complete(),
        hand="",
    )
    bench.handle(m.Execute(primitive=order))
    bench.tick(50)
    bench.subsystem.executors[ARM].halt()

    reports = [one for _, one in bench.tick(500) if isinstance(one, m.EndReport)]

    assert [(report.reason, report.hand) for report in reports[:1]] == [(StopReason.HALT, "")]


def test_the_next_process_has_the_hand_too(bench_at, tmp_path):
    bench = bench_at(at(HAND))
    couple(bench, HAND, 1)
    file = StateFile(tmp_path, "run", "MCM")
    file.save(bench.simulation.state())
    next_one = type(bench.simulation)(CELL)

    next_one.restore(file.load())

    assert next_one.arms[ARM].traits.hand == HAND
    assert next_one.truth()["tcp"][ARM] == pytest.approx(bench.simulation.truth()["tcp"][ARM], abs=REACHED_M)
    assert next_one.truth()["poses"][HAND] == pytest.approx(bench.simulation.truth()["poses"][HAND], abs=REACHED_M)


@pytest.mark.physics
def test_physics_and_control_law_have_the_mass_of_the_hand() -> None:
    joints = at(HAND)
    arm = placed(BulletCell(CELL), joints).arms[ARM]
    without = arm.mass_matrix(joints)
    assert arm.couple(HAND) == ""

    weighed = arm.mass_matrix(joints)

    assert weighed == pytest.approx(ArmModel.of(CELL.with_hands({ARM: HAND}), ARM).mass_matrix(joints), abs=1e-9)
    assert np.trace(weighed) > np.trace(without)


def test_an_arm_without_a_coupler_locks_nothing(bench_at):
    bench = bench_at(at(HAND))
    wanted = p.Primitive(
        id="C-2.1",
        performer="LEFT-ARM",
        trajectory=p.Coupling(hand=HAND),
        stop_functions=[
            p.StopFunction(reason=StopReason.GOAL, when=p.GoalReached()),
            p.StopFunction(reason=StopReason.TIMEOUT, when=p.TimeAbove(limit_s=3.0)),
        ],
    )

    report = bench.perform(wanted)

    assert (report.reason, report.hand) == (StopReason.REFUSED, None)


@pytest.mark.physics
def test_under_gravity_the_wrist_feels_no_weight_of_its_hand_and_the_rack_bears_it(make) -> None:
    simulation = placed(BulletCell(msgspec.structs.replace(CELL, gravity_m_s2=(0.0, 0.0, -9.81))), at(HAND))
    bench = make.Bench(simulation)
    bench.tick(200)
    before = simulation.truth()["poses"][HAND]

    for hand in (HAND, ""):
        assert couple(bench, hand, len(hand), planned_with="" if hand else HAND).hand == hand
        bench.tick(300)
        force = np.linalg.norm(simulation.arms[ARM].read().wrench[:3])
        assert force < 0.1 * 9.81 * CELL.object(HAND).mass_kg
        assert geometry.distance(simulation.truth()["poses"][HAND], before) < REACHED_M
