"""Whole motions in the default cell: free, within the rules, and round what stands in the way."""

from __future__ import annotations

import itertools
import math
import re

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Box, Frame, Object
from rtc.model.robot.collision import CollisionWorld
from rtc.model.robot.collision_scene import Held, Scene
from rtc.protocol import causes
from rtc.protocol.messages import Script
from rtc.spatial import geometry, hinges
from tests.workers.conftest import Bench, Reporter
from tests.workers.refusals import refusal_of
from workers.planning.motion import sampled_way
from workers.planning.motion.constraints import PathConstraints
from workers.planning.motion.ik import choose
from workers.planning.motion.plan import (
    PlanningRequest,
    before_contact,
    free_posture,
    plan_joint_motion,
    plan_task_motion,
)
from workers.planning.motion.timing import SpeedLimits
from workers.planning.robot_models import CellModel

FRONT, HANDLE = (0.45, -0.885, 0.60), (0.65, -0.885, 0.60)


def level(x, y, z):
    return geometry.make_pose((x, y, z), geometry.LEVEL)


@pytest.fixture
def setting(right, world, home):
    return PlanningRequest(right, world, home)


def with_joints(setting, *xyz):
    arm = setting.arm
    return {**setting.joints, arm.name: arm.ik(level(*xyz), setting.joints[arm.name])[0]}


def goal_at(setting, *xyz):
    return choose(setting.arm, level(*xyz), setting.start, test=free_posture(setting)).joints


def holding(cell, right, joints, thing="MACS-NEW"):
    in_hand = geometry.relative(right.fk(joints["RIGHT-ARM"]), cell.object_pose(thing))
    return Scene(held={thing: Held("RIGHT-ARM", in_hand)}, openings_m={"RIGHT-ARM": 0.02})


def test_from_home_to_the_rack_and_on_to_the_handle(setting, right, world, home):
    to_front = plan_joint_motion(setting, goal_at(setting, *FRONT))
    assert to_front.notes == ["generated a line in joint space; tested: free"]
    there = PlanningRequest(right, world, {**home, "RIGHT-ARM": to_front.goal_joints}, pace=SpeedLimits(0.1))
    to_handle = plan_task_motion(there, level(*HANDLE))
    assert geometry.distance(to_handle.goal_pose, HANDLE) < 1e-6
    assert to_handle.path.space == "task"
    assert to_handle.timed.duration_s == pytest.approx(2.2, abs=0.05)


def test_planning_twice_gives_the_same_motion(setting):
    a, b = (plan_joint_motion(setting, goal_at(setting, *FRONT)) for _ in range(2))
    assert np.array_equal(a.timed.positions, b.timed.positions)
    assert np.array_equal(a.timed.time_s, b.timed.time_s)


def test_a_blocked_line_is_modified_until_it_is_free(setting, cell, right, world, home):
    """R92. The lifted module goes from its rack to before the bay: the line in joint space cuts the satellite."""
    seated = with_joints(setting, *HANDLE)
    scene = holding(cell, right, seated)
    lifted = PlanningRequest(right, world, with_joints(setting, 0.45, -0.885, 0.75), scene)
    motion = plan_joint_motion(lifted, goal_at(lifted, 0.48, -0.085, 0.70))
    assert re.search("tested: MACS-NEW case .* SATELLITE right-panel", motion.notes[0])
    assert all(note.startswith("modified:") for note in motion.notes[1:])
    assert motion.notes[-1].endswith("tested: free")
    assert len(motion.path.knots) > 2
    # And it is: the timed knots themselves, each against the cell.
    assert world.check_path("RIGHT-ARM", motion.timed.positions, home, scene) is None
    assert geometry.distance(motion.goal_pose, (0.48, -0.085, 0.70)) < 1e-6


def test_a_way_of_our_own_choice_has_room_on_both_sides(setting, cell, right, world, home):
    """Held by HANDLE-B, the module passed the satellite at 0 mm, which is none: it was turned in the hand."""
    scene = holding(cell, right, with_joints(setting, 0.65, -0.715, 0.60))
    lifted = PlanningRequest(right, world, with_joints(setting, 0.65, -0.715, 0.85), scene)
    motion = plan_joint_motion(lifted, goal_at(lifted, 0.48, -0.085, 0.70))
    for asked_m, kept_m in ((0.0, 0.008), (0.010, 0.018)):
        asked = replace(scene, clearance_m=asked_m)
        motion = plan_joint_motion(replace(lifted, scene=asked), goal_at(lifted, 0.48, -0.085, 0.70))
        wide = replace(scene, clearance_m=0.99 * kept_m)
        assert world.check_path("RIGHT-ARM", motion.path.dense(0.002)[1], home, wide) is None


def test_where_there_is_no_room_at_the_goal_the_refusal_states_how_much_there_is(setting, cell, right, world, home):
    """The open hand before the satellite."""
    scene = Scene(openings_m={"RIGHT-ARM": 0.08}, clearance_m=0.005)
    at = PlanningRequest(right, world, with_joints(setting, 0.55, -0.085, 0.90), scene)
    goal = right.ik(level(0.732, -0.085, 0.90), at.start)[0]
    refusal = refusal_of(plan_joint_motion, at, goal)
    assert 0.0 < refusal.cause.distance_m < refusal.cause.margin_m == 0.005
    nearer = replace(at, scene=replace(scene, clearance_m=0.001))
    assert np.array_equal(plan_joint_motion(nearer, goal).goal_joints, goal)


def test_a_body_that_a_later_step_touches_is_an_obstacle_on_the_way_before(setting, right, world):
    """The hand may come near a handle at the end of its way, but does not pass it nearer than that."""
    scene = Scene(
        openings_m={"RIGHT-ARM": 0.08}, clearance_m=0.005, pose_tolerance_m={"MACS-NEW": 0.12}, near=["MACS-NEW"]
    )
    at = PlanningRequest(right, world, with_joints(setting, *FRONT), scene)
    goal = right.ik(level(0.55, -0.885, 0.60), at.start)[0]
    asked = before_contact(at, goal)
    assert not asked.scene.near
    (least_m,) = set(asked.scene.close.values())
    assert 0.005 < least_m < 0.12
    assert np.array_equal(plan_joint_motion(at, goal).goal_joints, goal)


def test_a_goal_that_is_just_far_enough_from_such_a_body_leaves_room_for_a_way(setting, right, world):
    """What a way keeps has no step between a goal that is a little too near and one that is just far enough."""
    at = PlanningRequest(right, world, with_joints(setting, *FRONT), Scene(openings_m={"RIGHT-ARM": 0.08}))
    goal = right.ik(level(0.55, -0.885, 0.60), at.start)[0]
    step_m, kept = 0.002, []
    for most_m in np.arange(0.04, 0.12, step_m).tolist():
        scene = replace(at.scene, clearance_m=0.005, pose_tolerance_m={"MACS-NEW": most_m}, near=["MACS-NEW"])
        asked = before_contact(replace(at, scene=scene), goal)
        kept.append(min([most_m, *asked.scene.close.values()]))
    assert np.abs(np.diff(kept)).max() < 1.01 * step_m
    assert kept[0] == 0.04  # far enough
    assert kept[-1] < max(kept) - 0.01  # nearer than it is unsure


def behind_a_wall(cell, right, setting):
    """A wall from floor to sky between the rack and the bay, before the arm."""
    slab, frame = Box(name="slab", size_m=(4.0, 0.02, 4.0)), Frame(xyz=(2.32, -0.45, 1.0))
    wall = Object(name="WALL", kind="obstacle", fixed=True, frame=frame, shapes=[slab])
    walled = CollisionWorld(msgspec.structs.replace(cell, objects=[*cell.objects, wall]))
    at = PlanningRequest(right, walled, with_joints(setting, *FRONT))
    return at, right.ik(level(0.55, 0.05, 0.95), at.start)[0]


def test_no_way_round_tells_the_first_obstacle_and_how_many_samples(right, cell, setting, monkeypatch):
    monkeypatch.setattr(sampled_way, "ROOMY_SAMPLES", 2)
    monkeypatch.setattr(sampled_way, "SAMPLES", 3)
    refusal = refusal_of(plan_joint_motion, *behind_a_wall(cell, right, setting))
    assert isinstance(refusal.cause, causes.Collides)
    assert refusal.cause.body_b == "WALL slab"
    assert 0 < refusal.fraction < 1
    assert refusal.effort.samples == 3


def test_a_wall_before_the_arm_is_passed_behind_it(right, cell, home, setting):
    """No line leads there: the arm turns about its base the other way round."""
    at, goal = behind_a_wall(cell, right, setting)
    motion = plan_joint_motion(at, goal)
    assert "of seed 0" in motion.notes[-1]
    assert at.world.check_path("RIGHT-ARM", motion.path.dense(0.004)[1], home) is None
    assert at.world.check_path("RIGHT-ARM", motion.timed.positions, home) is None
    assert np.allclose(motion.goal_joints, goal)


def test_the_seed_decides_the_way(right, cell, setting):
    at, goal = behind_a_wall(cell, right, setting)
    ways = [plan_joint_motion(replace(at, seed=seed), goal).path.knots for seed in (3, 3, 4)]
    assert np.array_equal(ways[0], ways[1])
    assert not np.array_equal(ways[0], ways[2])


def test_a_straight_line_into_something_is_refused_with_the_pair_and_the_place(setting, right, world):
    at = PlanningRequest(right, world, with_joints(setting, 0.48, -0.085, 0.90))
    refusal = refusal_of(plan_task_motion, at, level(0.78, -0.085, 0.90))
    assert isinstance(refusal.cause, causes.Collides)
    assert refusal.cause.body_a.startswith("RIGHT-ARM finger_")
    assert refusal.cause.body_b == "SATELLITE upper-panel"
    # The tips, 15 mm before the tcp, come to the panel (x 0.75) after 0.255 m of 0.30; checks are some 2 cm apart.
    assert 0.255 / 0.30 <= refusal.fraction <= 0.28 / 0.30
    assert refusal.where == f"{refusal.fraction:.0%} along the way"


def test_a_goal_inside_something_is_refused_before_any_way(setting):
    refusal = refusal_of(plan_joint_motion, setting, setting.arm.ik(level(0.80, -0.085, 0.90), setting.start)[0])
    assert refusal.cause.body_b == "SATELLITE upper-panel"


def test_a_goal_beyond_a_limit_names_the_joint(setting):
    goal = setting.start.copy()
    goal[2] = math.radians(-226)
    refusal = refusal_of(plan_joint_motion, setting, goal)
    assert refusal.cause.joint == "joint_3"
    assert refusal.cause.excess_rad == pytest.approx(math.radians(1))


def test_work_range_and_attitude_are_maintained(setting, cell, right, world, home):
    inside = PathConstraints(work_range=cell.region("BAY-2-RANGE"))
    goal = goal_at(setting, *FRONT)
    refusal = refusal_of(plan_joint_motion, PlanningRequest(right, world, home, path_constraints=inside), goal)
    assert isinstance(refusal.cause, causes.OutsideWorkRange)
    upright = PathConstraints(attitude=cell.attitudes["LEVEL"], attitude_name="LEVEL")
    motion = plan_joint_motion(PlanningRequest(right, world, home, path_constraints=upright), goal)
    assert "off LEVEL" in motion.notes[0]  # the line in joint space tips the hand over
    assert motion.path.space == "task"
    assert max(geometry.angle(right.fk(q), level(0, 0, 0)) for q in motion.timed.positions) < math.radians(5)


def test_an_attitude_is_kept_on_a_way_round(setting, cell, right, world, home):
    """Neither line to the front of the bay is free; each step of the search is projected onto the attitude."""
    upright = PathConstraints(attitude=cell.attitudes["LEVEL"], attitude_name="LEVEL")
    at = PlanningRequest(right, world, with_joints(setting, *FRONT), path_constraints=upright)
    motion = plan_joint_motion(at, goal_at(at, 0.48, -0.085, 0.70))
    assert "samples" in motion.notes[-1]
    assert max(geometry.angle(right.fk(q), level(0, 0, 0)) for q in motion.path.dense(0.005)[1]) < math.radians(5)
    assert max(geometry.angle(right.fk(q), level(0, 0, 0)) for q in motion.timed.positions) < math.radians(5)
    assert world.check_path("RIGHT-ARM", motion.path.dense(0.005)[1], home) is None


def test_an_arm_too_near_a_limit_may_leave_from_there(setting, right, world, home):
    near_limit = np.array(home["RIGHT-ARM"])
    near_limit[4] = right.limits.upper[4] - math.radians(1)
    at = PlanningRequest(right, world, {**home, "RIGHT-ARM": near_limit}, margin_rad=math.radians(5))
    assert np.array_equal(plan_joint_motion(at, home["RIGHT-ARM"]).goal_joints, home["RIGHT-ARM"])
    back = refusal_of(plan_joint_motion, PlanningRequest(right, world, home, margin_rad=math.radians(5)), near_limit)
    assert back.cause.joint == "joint_5"


def test_the_number_of_a_command_does_not_make_its_way_long() -> None:
    """It is the seed of the search. Of twelve ways past an open door four were three times as long as the others."""
    cell = Cell.load("servicing")
    bench = Bench(Reporter(cell), CellModel(cell))
    door = cell.object("DOOR-2")
    bench.set_fact("DOOR-2.angle", math.pi / 2)
    bench.set_fact("DOOR-2.frame", hinges.turned(door.frame.pose, door.hinge.axis, math.pi / 2).tolist())
    for sentence in ("GRASP MACS-NEW HANDLE-A WITH RIGHT-ARM", "EXTRACT MACS-NEW FROM RACK-1"):
        assert bench.do(sentence).succeeded

    def length_m() -> float:
        script = bench.elaborate("MOVE RIGHT-ARM TO CLEAR-POINT-1 MAINTAIN POSE-DURING-MOTION LEVEL")
        assert isinstance(script, Script), script
        knots = next(step.way.knots for step in script.steps if step.to and step.way is not None)
        places = [bench.model.arms["RIGHT-ARM"].fk(q)[:3] for q in knots]
        return sum(math.dist(here, there) for here, there in itertools.pairwise(places))

    found = [length_m() for _ in range(12)]
    assert max(found) < 1.6 * min(found)
