"""A way found for one planning request is used for an equal request, and for that only."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from rtc.model.robot.collision_scene import Scene
from rtc.protocol import causes
from rtc.protocol.messages import PlannedPath
from rtc.spatial import geometry
from tests.workers.refusals import refusal_of
from workers.planning import segments
from workers.planning.motion import path_reuse, plan
from workers.planning.motion.constraints import PathConstraints
from workers.planning.motion.path import through
from workers.planning.motion.plan import PlanningRequest
from workers.planning.motion.request import FreeWay
from workers.planning.motion.timing import SpeedLimits
from workers.planning.segments import Target

ASIDE = (0.45, -0.885, 0.60)


@pytest.fixture
def asked(right, world, home):
    return PlanningRequest(right, world, home, scene=Scene(poses={}, near=["RACK-1"]))


@pytest.fixture
def goal(asked):
    return asked.arm.ik(geometry.make_pose(ASIDE, geometry.LEVEL), asked.start)[0].tolist()


def sent(way: PlannedPath) -> PlannedPath:
    return msgspec.msgpack.decode(msgspec.msgpack.encode(way), type=PlannedPath)


@pytest.fixture
def untested(monkeypatch):
    """Once called, any test for collisions fails the test."""

    def planned_again(*_):
        raise AssertionError("a way that was found already is planned again")

    def forbid():
        for test in ("fault", "obstacle", "is_soon_free"):
            monkeypatch.setattr(plan, test, planned_again)

    return forbid


@pytest.mark.parametrize("space", ["move_joint", "move_task"])
def test_the_motion_is_the_same_and_nothing_is_tested_again(asked, goal, space, untested):
    target = Target(joints=goal) if space == "move_joint" else Target(pose=_beside(asked))
    anew = segments.plan_segment(asked, space, target)
    way = sent(segments.check_segment(asked, space, target, detours=False, first=True).way(asked, space))
    untested()
    handed_on = segments.plan_segment(asked, space, target, way)
    for name in ("time_s", "positions", "velocities", "accelerations"):
        assert np.array_equal(getattr(handed_on.timed, name), getattr(anew.timed, name)), name
    assert handed_on.notes == anew.notes


def test_a_way_with_detours_is_handed_on_too(asked, goal, monkeypatch, untested):
    obstacle, times = plan.obstacle, []

    def blocked_at_first(request, path):
        times.append(1)
        return plan.Refusal(reason="infeasible", message="blocked") if len(times) <= 1 else obstacle(request, path)

    monkeypatch.setattr(plan, "is_soon_free", lambda *_: False)
    monkeypatch.setattr(plan, "obstacle", blocked_at_first)
    segment = segments.check_segment(asked, "move_joint", Target(joints=goal), detours=True, first=True)
    way = segment.way(asked, "move_joint")
    assert len(way.knots) > 2
    untested()
    handed_on = segments.plan_segment(asked, "move_joint", Target(joints=goal), sent(way))
    assert "modified" in handed_on.notes[-1]
    assert np.allclose(handed_on.goal_joints, goal)


def test_rounded_corners_are_handed_on_as_they_are(asked, goal):
    path = through([asked.start, (asked.start + goal) / 2 + 0.2, asked.start - 0.1, goal], np.array([0.05, 0.02]))
    sent_on = path_reuse.from_message(sent(path_reuse.to_message(b"", FreeWay(path, ["found"]))))
    s = np.linspace(0.0, path.length, 50)
    assert all(np.array_equal(a, b) for a, b in zip(sent_on.path.at(s), path.at(s), strict=True))
    assert sent_on.notes == ["found"]


def _beside(asked):
    return geometry.translate(asked.arm.fk(asked.start), (0.0, 0.03, 0.0)).tolist()


def changes(asked):
    joints = {arm: [*values] for arm, values in asked.joints.items()}
    other = {**joints, "LEFT-ARM": [joints["LEFT-ARM"][0] + 1e-9, *joints["LEFT-ARM"][1:]]}
    yield replace(asked, joints=other)
    yield replace(asked, margin_rad=asked.margin_rad + 1e-6)
    yield replace(asked, path_constraints=PathConstraints(attitude_name="LEVEL"))
    scene = asked.scene
    yield replace(asked, scene=replace(scene, clearance_m=0.001))
    yield replace(asked, scene=replace(scene, poses={"MACS-NEW": geometry.IDENTITY}))
    yield replace(asked, scene=replace(scene, openings_m={"RIGHT-ARM": 0.01}))
    yield replace(asked, scene=replace(scene, keep_out=["BAY"]))
    yield replace(asked, scene=replace(scene, near=[]))
    yield replace(asked, scene=replace(scene, ignore=[("RIGHT-ARM", "MACS-NEW")]))


def test_everything_the_way_depends_on_changes_the_digest(asked, goal):
    same = path_reuse.request_digest(asked, "move_joint", goal)
    assert same == path_reuse.request_digest(
        replace(asked, scene=replace(asked.scene), pace=SpeedLimits(0.1)), "move_joint", np.array(goal)
    )
    others = [path_reuse.request_digest(changed, "move_joint", goal) for changed in changes(asked)]
    others += [
        path_reuse.request_digest(asked, "move_task", goal),
        path_reuse.request_digest(asked, "move_joint", [*goal[:5], goal[5] + 1e-9]),
    ]
    assert len({same, *others}) == 1 + len(others) == 12


def test_a_way_of_another_request_is_not_used(asked, goal, untested):
    way = segments.check_segment(asked, "move_joint", Target(joints=goal), detours=False, first=True).way(
        asked, "move_joint"
    )
    untested()
    with pytest.raises(AssertionError, match="planned again"):
        segments.plan_segment(replace(asked, margin_rad=0.01), "move_joint", Target(joints=goal), way)


def beside_a_wall(request, goal, cell):
    """The request with a module in the middle of the direct line, and the way round it."""
    middle = request.arm.fk(0.5 * (request.start + goal))
    blocked = replace(request, scene=replace(request.scene, poses={"MACS-NEW": middle}))
    found = plan.find_joint_way(blocked, goal)
    assert isinstance(found, FreeWay)
    assert len(found.path.knots) > 2
    return blocked, path_reuse.to_message(path_reuse.request_digest(blocked, "move_joint", goal), found)


def test_after_a_change_elsewhere_a_way_aside_is_tested_again_and_no_other_is_searched(asked, goal, cell, monkeypatch):
    request, way = beside_a_wall(asked, goal, cell)
    joints = {**request.joints, "LEFT-ARM": [q + 0.01 for q in request.joints["LEFT-ARM"]]}
    elsewhere = replace(request, joints=joints)
    monkeypatch.setattr(plan, "find_way_aside", lambda *_: pytest.fail("a way that is still free is searched again"))
    motion = segments.plan_segment(elsewhere, "move_joint", Target(joints=goal), sent(way))
    assert np.array_equal(motion.path.knots, np.array(way.knots))
    assert plan.is_free(elsewhere, motion.path)


def test_a_way_aside_that_is_no_longer_free_is_not_used(asked, goal, cell):
    request, way = beside_a_wall(asked, goal, cell)
    before = path_reuse.from_message(way).path
    on_it = request.arm.fk(before.joints_at(np.array([0.5 * before.length]))[0])
    moved = replace(request, scene=replace(request.scene, poses={**request.scene.poses, "MACS-OLD": on_it}))
    motion = segments.plan_segment(moved, "move_joint", Target(joints=goal), sent(way))
    assert not plan.is_free(moved, before)
    assert plan.is_free(moved, motion.path)


def test_a_way_to_the_pose_is_not_used_for_joints_of_another_turn(asked):
    pose = _beside(asked)
    way = segments.check_segment(asked, "move_task", Target(pose=pose), detours=False, first=True).way(
        asked, "move_task"
    )
    turned = asked.arm.ik(pose, asked.start)[0] + [0, 0, 0, 0, 0, 2 * np.pi]
    way = msgspec.structs.replace(
        way, request_digest=path_reuse.request_digest(asked, "move_task", asked.arm.fk(turned).tolist())
    )
    refusal = refusal_of(segments.plan_segment, asked, "move_task", Target(joints=turned.tolist()), way)
    assert isinstance(refusal.cause, causes.OtherBranch)
