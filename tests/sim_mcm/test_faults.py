"""Injected faults: each has its effect, is refused when it makes no sense, and is undone."""

from __future__ import annotations

import numpy as np
import pybullet
import pytest

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import faults as f
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.arms.kinematic_arm import KinematicCell
from sim_mcm.faults import Injections

ARM, MODULE, SEAT = "RIGHT-ARM", "MACS-NEW", "RACK-1"


class Rig:
    def __init__(self, cell, make, simulation) -> None:
        self.make, self.world = make, simulation
        self.bench = make.Bench(simulation)
        self.executor = self.bench.subsystem.executors[ARM]
        self.faults = Injections(cell, simulation, self.bench.subsystem.executors)
        self.model = ArmModel.of(cell, ARM)
        handle = cell.object(MODULE).grasp_point("HANDLE-A").frame.pose
        self.handle = geometry.compose(cell.object_pose(MODULE), handle)
        self._count = 0

    def do(self, trajectory: p.Trajectory, *stops: p.StopFunction, watch=None, limit_s: float = 30.0):
        self._count += 1
        wanted = self.make.primitive(trajectory, *stops, id=f"C-1.{self._count}", limit_s=limit_s)
        return self.bench.perform(wanted, watch=watch)

    def turn(self, by_rad: float, *stops: p.StopFunction, watch=None):
        """Turn the first joint."""
        start = self.executor.command[0]
        return self.do(self.make.joint_path(start, [start[0] + by_rad, *start[1:]], 1.0), *stops, watch=watch)

    def line(self, by_m, *stops: p.StopFunction):
        start = self.executor.command[0]
        goal = geometry.translate(self.model.fk(start), by_m)
        return self.do(self.make.line_path(self.model, start, goal, 0.1), *stops, limit_s=3.0)

    def at_handle(self) -> None:
        """Bring the hand to the handle at once. Exact arms only."""
        joints = self.model.ik(self.handle, near=self.executor.command[0])[0].tolist()
        self.world.arms[ARM].follow((joints, [0.0] * 6, [0.0] * 6))
        self.world.step()
        self.executor._setpoints.stand_at(joints)
        self.bench.tick()

    def grip(self) -> None:
        self.at_handle()
        assert self.do(p.HandMotion(width_m=0.0, force_n=30.0)).reason is StopReason.GOAL
        assert self.world.held()[ARM] == [MODULE]


@pytest.fixture
def exact(cell, make) -> Rig:
    return Rig(cell, make, KinematicCell(cell))


@pytest.fixture
def physical(cell, make):
    world = BulletCell(cell)
    yield Rig(cell, make, world)
    world.close()


@pytest.mark.physics
@pytest.mark.parametrize("stuck", [1, 2, 3, 4, 5, 6])
def test_the_joint_that_is_stuck_is_named(physical, make, stuck) -> None:
    """In motion of all joints: lighter joints are off their commands before it is."""
    start, ticks = physical.executor.command[0], [0]

    def watch() -> None:
        ticks[0] += 1
        if ticks[0] == 300:
            assert physical.faults.inject(f.StuckJoint(arm=ARM, joint=f"joint_{stuck}")) == ""

    goal = [q + by for q, by in zip(start, (-0.4, 0.4, -0.4, -0.3, -0.4, -0.4), strict=True)]
    report = physical.do(make.joint_path(start, goal, 1.0), watch=watch)
    assert report.reason is StopReason.FOLLOWING_ERROR
    assert report.message.startswith(f"joint_{stuck} ")  # wording: the joint that is named


def test_a_motion_is_made_to_end_for_a_reason_once(exact) -> None:
    advance = exact.faults.advance
    assert exact.faults.inject(f.ForcedEnd(arm=ARM, reason=StopReason.SLIP)) == ""
    assert not advance()  # the arm rests
    ended = []
    report = exact.turn(-0.3, watch=lambda *_: ended.append(advance()))
    assert (report.reason, ended.count(True), exact.faults.active) == (StopReason.SLIP, 1, [])
    assert exact.turn(-0.3, watch=lambda *_: advance()).reason is StopReason.GOAL


@pytest.mark.parametrize("kind", ["exact", pytest.param("physical", marks=pytest.mark.physics)])
def test_a_stuck_joint_is_noticed_by_its_following_error(kind, request) -> None:
    rig = request.getfixturevalue(kind)
    assert rig.faults.inject(f.StuckJoint(arm=ARM, joint="joint_1")) == ""
    report = rig.turn(-0.3)
    assert report.reason is StopReason.FOLLOWING_ERROR
    assert rig.faults.undo("stick RIGHT-ARM joint_1") == ("", "")
    assert rig.turn(-0.3).reason is StopReason.GOAL


@pytest.mark.parametrize("kind", ["exact", pytest.param("physical", marks=pytest.mark.physics)])
def test_a_false_offset_in_motion_counts_as_a_force(kind, request, make) -> None:
    rig = request.getfixturevalue(kind)
    guard = make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=20.0))
    ticks = [0]

    def watch() -> None:
        ticks[0] += 1
        if ticks[0] == 300:
            assert rig.faults.inject(f.FalseSensor(arm=ARM, offset=[0.0, 0.0, 30.0, 0.0, 0.0, 0.0])) == ""

    report = rig.turn(-0.3, guard, watch=watch)
    assert (report.reason, report.measured) == (StopReason.FORCE_LIMIT, pytest.approx(30.0, abs=2.0))
    rig.faults.undo("ALL")
    assert rig.executor.arm is rig.world.arms[ARM]
    assert rig.turn(-0.1, guard).reason is StopReason.GOAL


def test_a_frozen_sensor_does_not_feel_a_contact(exact, make) -> None:
    feel = make.stop(StopReason.CONTACT, p.ForceAbove(limit_n=5.0))
    exact.at_handle()
    assert exact.faults.inject(f.FalseSensor(arm=ARM)) == ""
    assert exact.line((0.0, 0.035, 0.0), feel).reason is StopReason.GOAL  # it leans on the handle
    assert exact.faults.undo("sensor RIGHT-ARM") == ("", "")
    exact.at_handle()
    assert exact.line((0.0, 0.035, 0.0), feel).reason is StopReason.CONTACT


def test_a_module_in_a_jammed_seat_cannot_be_pulled_out(exact, make) -> None:
    exact.grip()
    assert exact.faults.inject(f.JammedSeat(seat=SEAT)) == ""
    guard = make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=60.0))
    assert exact.line((0.0, 0.0, 0.05), guard).reason is StopReason.FORCE_LIMIT
    exact.faults.undo(f"jam {SEAT}")
    assert exact.line((0.0, 0.0, 0.05), guard).reason is StopReason.GOAL


def test_a_module_is_wedged_before_its_place_in_a_jammed_seat(exact, make) -> None:
    exact.grip()
    assert exact.line((0.0, 0.0, 0.1)).reason is StopReason.GOAL
    exact.faults.inject(f.JammedSeat(seat=SEAT))
    guard = make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=60.0))
    assert exact.line((0.0, 0.0, -0.1), guard).reason is StopReason.FORCE_LIMIT
    height_m = exact.world.truth()["poses"][MODULE][2] - exact.world.truth()["seats"][SEAT][2]
    assert 0.03 < height_m < 0.041


@pytest.mark.physics
def test_jammed_seats_hold_with_more_than_their_catches(physical) -> None:
    def pull() -> float:
        """Motion (m) of the module while 100 N pull it out for a fifth of a second."""
        body, client = physical.world.world.objects[MODULE].id, physical.world.world.client
        before = physical.world.truth()["poses"][MODULE]
        for _ in range(200):
            here = physical.world.truth()["poses"][MODULE][:3]
            force = [0.0, 0.0, 100.0]
            pybullet.applyExternalForce(body, -1, force, here, pybullet.WORLD_FRAME, physicsClientId=client)
            physical.world.step()
        return geometry.distance(physical.world.truth()["poses"][MODULE], before)

    assert physical.faults.inject(f.JammedSeat(seat=SEAT)) == ""
    assert pull() < 0.001
    physical.faults.undo("ALL")
    assert pull() > 0.05


def test_a_failed_hand_drops_what_it_holds_and_closes_again_when_it_is_undone(exact, make) -> None:
    exact.grip()
    held = make.stop(StopReason.SLIP, p.GripForceBelow(5.0))
    ticks = [0]

    def watch() -> None:
        ticks[0] += 1
        if ticks[0] == 100:
            assert exact.faults.inject(f.FailedHand(arm=ARM)) == ""

    assert exact.do(p.HoldStill(duration_s=1.0), held, watch=watch).reason is StopReason.SLIP
    close = p.HandMotion(width_m=0.0, force_n=30.0)
    assert exact.do(close, limit_s=0.5).reason is StopReason.TIMEOUT  # it does not obey
    assert exact.world.held()[ARM] == []
    exact.faults.undo("ALL")
    assert exact.do(close).reason is StopReason.GOAL
    assert exact.world.held()[ARM] == [MODULE]


def test_a_hand_that_closes_on_something_reads_empty_once(exact) -> None:
    exact.at_handle()
    close, free = p.HandMotion(width_m=0.0, force_n=30.0), p.HandMotion(width_m=0.08, force_n=30.0)
    assert exact.faults.inject(f.MisreadHand(arm=ARM)) == ""
    ended = []

    def do(motion: p.HandMotion) -> list[float]:
        report = exact.do(motion, watch=lambda *_: ended.append(exact.faults.advance()))
        assert report.reason is StopReason.GOAL
        return [report.hand_width_m, report.hand_force_n]

    assert do(close) == [0.0, 0.0]
    assert exact.world.held()[ARM] == [MODULE]  # in truth
    assert (any(ended), exact.faults.active) == (False, ["misread RIGHT-ARM"])
    assert do(free) == pytest.approx([0.08, 0.0], abs=0.001)
    assert (ended.count(True), exact.faults.active) == (1, [])
    assert exact.executor.arm is exact.world.arms[ARM]
    assert do(close) == pytest.approx([0.02, 30.0], rel=0.05)


def test_a_weak_hand_loses_its_force_and_has_it_again_when_it_closes(exact) -> None:
    exact.grip()
    assert exact.faults.inject(f.WeakHand(arm=ARM, n_s=5.0)) == ""

    def force_n(trajectory: p.Trajectory) -> float:
        return exact.do(trajectory, watch=lambda *_: exact.faults.advance()).hand_force_n

    assert force_n(p.HoldStill(duration_s=2.0)) == pytest.approx(20.0, abs=0.5)
    assert force_n(p.HoldStill(duration_s=1.0)) == pytest.approx(15.0, abs=0.5)
    assert force_n(p.HandMotion(width_m=0.0, force_n=30.0)) > 29.0
    assert force_n(p.HoldStill(duration_s=2.0)) == pytest.approx(20.0, abs=1.0)
    assert exact.faults.undo("ALL") == ("", "")
    kept_n = exact.do(p.HoldStill(duration_s=0.1)).hand_force_n
    assert exact.do(p.HoldStill(duration_s=1.0)).hand_force_n == kept_n
    assert exact.executor.arm is exact.world.arms[ARM]


@pytest.mark.physics
def test_a_blunt_seat_has_no_lips_until_this_is_undone(physical) -> None:
    def has_lips() -> bool:
        world = physical.world.world
        lip = next(part for part, name in world.names.items() if name == "BAY-2 left-lip")
        at, _ = pybullet.getBasePositionAndOrientation(lip, physicsClientId=world.client)
        return bool(np.linalg.norm(at) < 10.0)

    assert has_lips()
    assert physical.faults.inject(f.BluntSeat(seat="BAY-2")) == ""
    assert not has_lips()
    before = physical.world.truth()["seats"]["BAY-2"]
    assert physical.faults.inject(f.Displaced(object="BAY-2", offset=[0.0, 0.002, 0.0, 0.0, 0.0, 0.0])) == ""
    assert not has_lips()
    after = physical.world.truth()["seats"]["BAY-2"]
    assert np.subtract(after, before)[:3] == pytest.approx([0.0, 0.002, 0.0])
    physical.faults.undo("ALL")
    assert has_lips()
    assert physical.world.truth()["seats"]["BAY-2"] == pytest.approx(before)


@pytest.mark.parametrize("kind", ["exact", pytest.param("physical", marks=pytest.mark.physics)])
def test_a_seat_is_displaced_if_it_is_empty(kind, request) -> None:
    rig = request.getfixturevalue(kind)
    offset = [0.0, 0.01, 0.0, 0.0, 0.0, 0.0]
    assert "MACS-NEW is in RACK-1" in rig.faults.inject(f.Displaced(object="RACK-1", offset=offset))
    before = rig.world.truth()["seats"]["BAY-2"]
    assert rig.faults.inject(f.Displaced(object="BAY-2", offset=offset)) == ""
    assert np.subtract(rig.world.truth()["seats"]["BAY-2"], before)[:3] == pytest.approx(offset[:3])
    assert rig.faults.undo("ALL") == ("", "")
    assert rig.world.truth()["seats"]["BAY-2"] == pytest.approx(before)


def test_a_displaced_object_returns_unless_it_was_moved_since(exact) -> None:
    before = exact.world.truth()["poses"][MODULE]
    offset = [0.01, -0.02, 0.03, 0.1, -0.2, 0.3]
    assert exact.faults.inject(f.Displaced(object=MODULE, offset=offset)) == ""
    assert geometry.distance(exact.world.truth()["poses"][MODULE], before) == pytest.approx(np.linalg.norm(offset[:3]))
    assert exact.faults.undo("ALL") == ("", "")
    assert exact.world.truth()["poses"][MODULE] == pytest.approx(before, abs=1e-9)
    exact.faults.inject(f.Displaced(object=MODULE, offset=offset))
    exact.world.displace(MODULE, [0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    assert exact.faults.undo("ALL") == ("", "MACS-NEW was moved since, and stays where it is")
    assert exact.faults.active == []


def test_a_drifting_object_turns_and_moves_steadily_until_it_is_held_or_this_is_undone(exact) -> None:
    before = exact.world.truth()["poses"]["SATELLITE"]
    fault = f.Drifting(object="SATELLITE", velocity=[0.0, 0.01, 0.0, 0.1, 0.0, 0.0])
    assert exact.faults.inject(fault) == ""
    for _ in range(1000):
        exact.faults.advance()
    after = exact.world.truth()["poses"]["SATELLITE"]
    assert geometry.relative(before, after)[:3] == pytest.approx([0.0, 0.01, 0.0], abs=1e-6)
    assert geometry.rotation_vector(before, after) == pytest.approx([0.1, 0.0, 0.0], abs=1e-6)
    assert exact.faults.active == ["drift SATELLITE with 0, 0.01, 0 m/s, 0.1, 0, 0 rad/s"]
    assert exact.faults.undo("ALL") == ("", "")
    exact.faults.advance()
    assert exact.world.truth()["poses"]["SATELLITE"] == after

    exact.grip()
    held = exact.world.truth()["poses"][MODULE]
    exact.faults.inject(f.Drifting(object=MODULE, velocity=[0.1] * 6))
    for _ in range(100):
        exact.faults.advance()
    assert exact.world.truth()["poses"][MODULE] == held


def test_what_is_held_is_not_displaced(exact) -> None:
    exact.grip()
    assert exact.faults.inject(f.Displaced(object=MODULE, offset=[0.1] + [0.0] * 5)) == "MACS-NEW is held by RIGHT-ARM"


def test_a_fault_of_the_same_name_replaces_the_first(exact) -> None:
    exact.faults.inject(f.SlowLoop(tick_s=0.001))
    exact.faults.inject(f.BlindCamera(camera="CAMERA-1"))
    exact.faults.inject(f.SlowLoop(tick_s=0.002))
    assert exact.faults.active == ["blind CAMERA-1", "slow by 2 ms per tick"]
    assert (exact.faults.tick_s, exact.faults.blind) == (0.002, {"CAMERA-1"})
    exact.faults.undo("ALL")
    assert (exact.faults.tick_s, exact.faults.blind, exact.faults.active) == (0.0, set(), [])


@pytest.mark.parametrize(
    ("fault", "word"),
    [
        (f.Drifting(object="SATELLIT", velocity=[0.0] * 6), "there is no object SATELLIT"),
        (f.Drifting(object="SATELLITE", velocity=[0.0] * 5 + [np.inf]), "six finite numbers"),
        (f.StuckJoint(arm="NO-ARM", joint="joint_1"), "there is no arm NO-ARM"),
        (f.StuckJoint(arm=ARM, joint="joint_9"), "there is no joint of RIGHT-ARM joint_9"),
        (f.Displaced(object="NOTHING", offset=[0.0] * 6), "there is no object or seat NOTHING"),
        (f.Displaced(object=MODULE, offset=[float("nan")] * 6), "six finite numbers"),
        (f.FalseSensor(arm=ARM, offset=[1e9] * 6), "six finite numbers"),
        (f.FalseSensor(arm=ARM, offset=[1.0]), "six finite numbers"),
        (f.JammedSeat(seat="BAY-9"), "there is no seat BAY-9"),
        (f.BluntSeat(seat="BAY-9"), "there is no seat BAY-9"),
        (f.BluntSeat(seat="BAY-2"), "arms with physics"),
        (f.MisreadHand(arm="NO-ARM"), "there is no arm NO-ARM"),
        (f.WeakHand(arm="NO-ARM", n_s=1.0), "there is no arm NO-ARM"),
        (f.WeakHand(arm=ARM, n_s=0.0), "up to 100 N/s"),
        (f.WeakHand(arm=ARM, n_s=float("nan")), "up to 100 N/s"),
        (f.StrippedBolt(bolt="BOLT-1"), "the cell swapout has no bolts"),
        (f.FailedHand(arm=ARM), "RIGHT-ARM holds nothing"),
        (f.BlindCamera(camera="CAMERA-9"), "there is no camera CAMERA-9"),
        (f.ForcedEnd(arm="NO-ARM", reason=StopReason.SLIP), "there is no arm NO-ARM"),
        (f.ForcedEnd(arm=ARM, reason=StopReason.GOAL), "there is no reason to force goal"),
        (f.SlowLoop(tick_s=1.0), "0.1 to 50 ms"),
        (f.SlowLoop(tick_s=float("nan")), "0.1 to 50 ms"),
    ],
)
def test_a_wrong_fault_is_refused_and_changes_nothing(exact, fault, word) -> None:
    assert word in exact.faults.inject(fault)
    assert exact.faults.active == []


def test_undoing_what_is_not_injected_names_what_is(exact) -> None:
    exact.faults.inject(f.SlowLoop(tick_s=0.001))
    assert exact.faults.undo("jam BAY-2") == ("jam BAY-2 is not injected; active are: slow", "")
    assert exact.faults.undo("ALL") == ("", "")
    assert exact.faults.undo("ALL") == ("", "")
