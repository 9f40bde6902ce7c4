"""The physics: that it is the model's physics, and that a thing can be felt, gripped and carried by forces alone.

Loose tolerances on purpose: pybullet's figures vary with its version. What was measured stands in docs/physics.md.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pybullet
import pytest

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry
from rtc.subsystems.motion import profiles
from rtc.subsystems.motion.arm import TICK_S
from rtc.subsystems.motion.modes import Mode
from sim_mcm.arms.bullet_arm import BulletCell

pytestmark = pytest.mark.physics
ARM, MODULE = "RIGHT-ARM", "MACS-NEW"


@pytest.fixture
def world(cell):
    made = BulletCell(cell)
    yield made
    made.close()


@pytest.fixture(scope="module")
def model(cell) -> ArmModel:
    return ArmModel.of(cell, ARM)


@pytest.fixture
def bench(world, make):
    return make.Bench(world)


@pytest.fixture
def handle(cell):
    return geometry.compose(cell.object_pose(MODULE), cell.object(MODULE).grasp_point("HANDLE-A").frame.pose)


@pytest.fixture
def go(bench, make, model):
    """Move the right hand: `go(pose, speed, *stops)`; the way there is a straight line of the tcp, or joints."""
    count = [0]

    def move(goal, speed_m_s: float, *stops, straight: bool = True, watch=None):
        count[0] += 1
        start = bench.subsystem.executors[ARM].command[0]
        if straight:
            path = make.line_path(model, start, goal, speed_m_s)
        else:
            path = make.joint_path(start, model.ik(goal, near=start)[0].tolist(), 2.5)
        return bench.perform(make.primitive(path, *stops, id=f"C-1.{count[0]}"), watch=watch)

    return move


def test_the_mass_matrix_of_the_physics_is_that_of_the_control_law(world, model) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = rng.uniform(model.limits.lower, model.limits.upper)
        ours = pin.crba(model.model, model.model.createData(), q)
        ours = np.triu(ours) + np.triu(ours, 1).T
        assert world.arms[ARM].mass_matrix(q) == pytest.approx(ours, abs=1e-9)


def test_a_line_at_full_speed_is_followed_within_a_tenth_of_a_millimetre(world, bench, cell, model, go) -> None:
    start = model.fk(cell.arm(ARM).home_rad)
    worst = [0.0]

    def watch() -> None:
        executor = bench.subsystem.executors[ARM]
        error = geometry.distance(model.fk(executor.command[0]), model.fk(executor.sample.joints))
        worst[0] = max(worst[0], error)

    report = go(geometry.translate(start, (-0.15, 0.1, -0.25)), 0.25, watch=watch)

    assert report.reason is StopReason.GOAL
    assert worst[0] < 1e-4
    assert report.peak_force_n < 2.0  # of the hand's own inertia


def test_a_paused_line_is_left_by_less_than_a_millimetre(bench, cell, model, go) -> None:
    """Pause in the fastest part, stand, go on."""
    executor = bench.subsystem.executors[ARM]
    start, way = model.fk(cell.arm(ARM).home_rad), np.array([-0.15, 0.1, -0.25])
    along = way / np.linalg.norm(way)
    off, ticks, stood = [], [0], []

    def watch() -> None:
        ticks[0] += 1
        if ticks[0] == 1000:
            executor.pace(True)
        elif ticks[0] == 2500:
            executor.pace(False)
        part = model.fk(executor.sample.joints)[:3] - start[:3]
        off.append(float(np.linalg.norm(part - (part @ along) * along)))
        if 2400 < ticks[0] < 2500:
            stood.append(part)

    report = go(geometry.translate(start, way), 0.25, watch=watch)
    assert report.reason is StopReason.GOAL
    assert max(off) < 1e-3
    assert np.ptp(stood, axis=0).max() < 1e-5
    assert 0.1 < np.linalg.norm(stood[-1]) < 0.3


@pytest.mark.parametrize("scale", [1.0, 0.4])
def test_a_guarded_move_feels_the_handle_in_that_tick_and_hardly_presses(bench, make, handle, go, scale) -> None:
    front = geometry.compose(handle, (0.0, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0))
    go(front, 0.25, straight=False)
    go(handle, 0.1)
    seen: list[tuple[Mode, float]] = []

    def watch() -> None:
        executor = bench.subsystem.executors[ARM]
        seen.append((executor.state, float(np.linalg.norm(executor.command[1]))))

    feel = make.stop(StopReason.CONTACT, p.ForceAbove(limit_n=5.0))
    report = go(geometry.translate(handle, (0.0, 0.05, 0.0)), 0.02 * scale, feel, watch=watch)

    assert report.reason is StopReason.CONTACT
    assert report.measured > 5.0
    assert report.trip_wrench[1] < -2.0  # the handle pushes the finger back
    assert report.peak_force_n < 10.0
    assert np.linalg.norm(report.wrench[:3]) < 1.0  # at rest it does not lean on it
    # 30 mm to the handle, up to 3 more until the module leans on the wall of its rack
    assert 0.0295 < report.trip_pose[1] - handle[1] < 0.0345
    moving = [speed for state, speed in seen if state is Mode.EXECUTING]
    braking = [speed for state, speed in seen if state is not Mode.EXECUTING]
    assert braking[0] < moving[-1]  # the tick that feels it already brakes


def test_figure_4_feel_both_sides_centre_close_and_lift(world, bench, make, handle, model, go) -> None:
    # Given the open hand about the handle, 6 mm off its middle
    aside = geometry.translate(handle, (0.0, 0.006, 0.0))
    go(geometry.compose(aside, (0.0, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0)), 0.25, straight=False)
    go(aside, 0.1)
    guard = make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=20.0))
    feel = make.stop(StopReason.CONTACT, p.ForceAbove(limit_n=5.0))

    # When it feels one side and the other, goes to the middle, closes, and lifts
    sides = [go(geometry.translate(aside, (0.0, way, 0.0)), 0.02, guard, feel) for way in (0.045, -0.05)]
    assert [side.reason for side in sides] == [StopReason.CONTACT] * 2
    middle = 0.5 * (sides[0].trip_pose[1] + sides[1].trip_pose[1])
    assert middle == pytest.approx(handle[1], abs=0.002)
    centre = geometry.make_pose((aside[0], middle, aside[2]), aside[3:])
    go(centre, 0.02, guard)
    grip = bench.perform(make.primitive(p.HandMotion(width_m=0.0, force_n=30.0), guard, id="C-2.1"))
    assert grip.reason is StopReason.GOAL
    assert grip.hand_width_m == pytest.approx(0.02, abs=0.0005)
    assert grip.hand_force_n == pytest.approx(30.0, rel=0.05)
    assert world.held() == {ARM: [MODULE], "LEFT-ARM": []}

    before = world.truth()
    lost = make.stop(StopReason.OBJECT_LOST, p.HandWidthBelow(0.018))
    slip = make.stop(StopReason.SLIP, p.GripForceBelow(20.0))
    up = geometry.translate(centre, (0.0, 0.0, 0.15))
    lift = go(up, 0.1, lost, slip)
    carry = go(geometry.translate(up, (-0.1, 0.1, 0.1)), 0.25, lost, slip)
    after = world.truth()

    # Then the module has come along, and not slipped in the fingers
    assert [lift.reason, carry.reason] == [StopReason.GOAL] * 2
    grasps = [
        geometry.relative(geometry.make_pose(t["tcp"][ARM][:3], t["tcp"][ARM][3:]), t["poses"][MODULE])
        for t in (before, after)
    ]
    assert geometry.distance(*grasps) < 0.002
    assert np.degrees(geometry.angle(*grasps)) < 1.0
    moved = np.array(after["poses"][MODULE][:3]) - before["poses"][MODULE][:3]
    assert moved == pytest.approx([-0.1, 0.1, 0.25], abs=0.002)

    # and it stays behind when the hand opens
    bench.perform(make.primitive(p.HandMotion(width_m=0.08, force_n=30.0), id="C-2.2"))
    assert world.held()[ARM] == []
    assert np.linalg.norm(world.truth()["velocities"][MODULE][:3]) < 0.005


def test_pads_stay_on_the_bar_while_the_hand_turns(world, make, cell, model, handle) -> None:
    """A contact point that keeps its old normal would hold a pad away from the bar as the hand turns. When pybullet
    drops the point, the pad falls onto the bar, and the wrist feels up to 46 N."""
    # Given a module in the right hand, in front of its rack
    tcp = geometry.translate(handle, (0.0, 0.0, 0.15))
    start = model.ik(tcp, near=cell.arm(ARM).home_rad)[0].tolist()
    state = world.state()
    point = cell.object(MODULE).grasp_point("HANDLE-A").frame.pose
    state.poses[MODULE] = geometry.compose(tcp, geometry.inverse(point)).tolist()
    state.arms[ARM].joints = start
    world.restore(state)
    bench = make.Bench(world)
    bench.perform(make.primitive(p.HandMotion(width_m=0.0, force_n=45.0), id="C-1.1"))
    assert world.held()[ARM] == [MODULE]

    # When the hand turns by 70 degrees
    arm, body = world.arms[ARM], world.world.objects[MODULE].id
    turned = geometry.compose(tcp, geometry.from_rpy((0.0, 0.0, 0.0), (1.2, 0.0, 0.0)))
    goal = model.ik(geometry.translate(turned, (-0.2, 0.3, 0.2)), near=start)[0].tolist()
    gaps_m: list[float] = []

    def watch() -> None:
        if round(bench.now_s / TICK_S) % 50 == 0:
            for finger in arm.fingers:
                points = pybullet.getClosestPoints(arm.body, body, 0.01, finger, physicsClientId=world.world.client)
                gaps_m.append(min(point[8] for point in points))

    report = bench.perform(make.primitive(make.joint_path(start, goal, 2.5), id="C-1.2"), watch=watch)

    # Then the pads touch the bar all the time, and the wrist feels nothing but inertia
    assert report.reason is StopReason.GOAL, report.message
    assert max(gaps_m) < 5e-5
    assert report.peak_force_n < 12.0


def test_a_stop_at_full_speed_does_not_saturate_the_motors(world, bench, make, cell, model) -> None:
    start = cell.arm(ARM).home_rad
    path = make.line_path(model, np.array(start), geometry.translate(model.fk(start), (-0.15, 0.1, -0.25)), 0.25)
    at_half = make.stop(StopReason.CONTACT, p.TimeAbove(0.5 * path.duration_s))
    report = bench.perform(make.primitive(path, at_half))
    stopped_m = geometry.distance(report.trip_pose, report.tcp_pose)
    assert report.reason is StopReason.CONTACT
    assert 0.001 < stopped_m < 0.02
    assert report.peak_force_n < 12.0  # inertia of the hand; profiles.STOP_ACCELERATION_RAD_S2 is what makes it so
    assert profiles.STOP_ACCELERATION_RAD_S2 <= 15.0


def test_a_free_module_keeps_its_velocity(world) -> None:
    body = world.world.objects[MODULE]
    world._detents.let_go(MODULE)  # by the catch of its seat, which knows only pulling
    world.world.place(body, geometry.make_pose((0.0, 0.0, 3.0)))
    pybullet.resetBaseVelocity(body.id, [0.01, 0.0, 0.02], [0.0, 0.0, 0.3], physicsClientId=world.world.client)
    for _ in range(5000):
        world.step()
    truth = world.truth()
    assert truth["velocities"][MODULE] == pytest.approx([0.01, 0.0, 0.02, 0.0, 0.0, 0.3], abs=1e-6)
    assert truth["poses"][MODULE][:3] == pytest.approx([0.05, 0.0, 3.1], abs=1e-3)


def test_an_arm_that_hits_the_other_says_so_and_can_be_moved_away(world, bench, make, cell) -> None:
    # Given a swing of the stretched right arm towards the left
    start = cell.arm(ARM).home_rad
    touch = make.stop(StopReason.COLLISION, p.BodyTouch())
    report = bench.perform(make.primitive(make.joint_path(start, [1.57, 0, -1.57, 0, 0, 0], 6.0), touch))
    assert report.reason is StopReason.ARM_CONTACT
    mine, _, theirs = report.message.partition(" touches ")
    assert mine.removeprefix(f"{ARM} ") in world.arms[ARM].upstream.values()
    assert theirs.startswith("LEFT-ARM ")

    # When it is commanded back, still touching, then it moves
    here = bench.subsystem.executors[ARM].command[0]
    back = bench.perform(make.primitive(make.joint_path(here, start, 6.0), touch, id="C-7.2"))
    assert back.reason is StopReason.GOAL


def test_displacing_a_module_takes_its_seat_along(world) -> None:
    before = world.world.pose(MODULE)
    assert world.displace(MODULE, [0.0, 0.02, 0.0, 0.0, 0.0, 0.0]) == ""
    assert "NOTHING" in world.displace("NOTHING", [0.0] * 6)
    for _ in range(200):
        world.step()
    assert world.world.pose(MODULE)[:3] - before[:3] == pytest.approx([0.0, 0.02, 0.0], abs=1e-6)
    assert world.world.seats["RACK-1"].home[1] == pytest.approx(-0.78)
