"""Collisions by name, in postures where one can tell by hand what touches what."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest
from msgspec.structs import replace

from rtc.model.robot.collision import CollisionWorld
from rtc.model.robot.collision_scene import Held, Scene
from rtc.protocol import causes
from rtc.spatial import geometry

TOLERANCE_M = 1e-5  # of a proof
HANDLE = (0.65, -0.885, 0.60)  # HANDLE-A of the module in RACK-1


def level(x, y, z):
    return geometry.make_pose((x, y, z), geometry.LEVEL)


def right_at(right, home, *xyz):
    """Both arms' joints with the right hand LEVEL there, nearest to home."""
    return {**home, "RIGHT-ARM": right.ik(level(*xyz), home["RIGHT-ARM"])[0]}


def names(collision):
    return collision and {collision.body_a, collision.body_b}


def test_home_and_stow_are_free_in_any_mixture(cell, world, home):
    stow = {arm.name: arm.stow_rad for arm in cell.arms}
    roomy = Scene(clearance_m=0.05)
    for joints in (home, stow, {**home, "LEFT-ARM": stow["LEFT-ARM"]}, {**stow, "LEFT-ARM": home["LEFT-ARM"]}):
        assert world.check(joints, roomy) is None


def test_open_fingers_straddle_the_handle(world, right, home):
    assert world.check(right_at(right, home, *HANDLE)) is None


@pytest.mark.parametrize(("off", "finger"), [(0.035, "finger_b"), (-0.035, "finger_a")])
def test_a_finger_beside_its_place_hits_the_bar(world, right, home, off, finger):
    x, y, z = HANDLE
    hit = world.check(right_at(right, home, x, y + off, z))
    assert names(hit) == {f"RIGHT-ARM {finger}", "MACS-NEW handle-a"}
    # 40 mm to the finger's inside, 10 mm of bar: 5 mm into each other
    assert hit.distance_m == pytest.approx(-0.005, abs=1e-4)
    assert hit.point[0] == pytest.approx(x, abs=0.02)


def test_closed_fingers_run_into_the_bar(world, right, home):
    hit = world.check(right_at(right, home, *HANDLE), Scene(openings_m={"RIGHT-ARM": 0.0}))
    assert "MACS-NEW handle-a" in names(hit)


def test_too_deep_the_fingers_meet_the_case(world, right, home):
    x, _, z = HANDLE
    hit = world.check(right_at(right, home, x + 0.04, -0.80, z))  # between the two handles
    assert hit.body_a in ("RIGHT-ARM finger_a", "RIGHT-ARM finger_b")
    assert hit.body_b == "MACS-NEW case"
    assert hit.distance_m == pytest.approx(-0.005, abs=1e-4)  # tips 15 mm before the tcp


def test_what_may_touch_is_ignored(world, right, home):
    x, y, z = HANDLE
    joints = right_at(right, home, x, y + 0.035, z)
    assert world.check(joints, Scene(ignore=[("RIGHT-ARM finger_b", "MACS-NEW handle-a")])) is None
    assert world.check(joints, Scene(ignore=[("RIGHT-ARM", "MACS-NEW")])) is None
    assert world.check(joints, Scene(ignore=[("RIGHT-ARM finger_a", "MACS-NEW")])) is not None


def test_what_touches_without_the_moving_arm_is_not_its_business(world, right, home):
    pressed = right_at(right, home, HANDLE[0], HANDLE[1] + 0.03, HANDLE[2])  # a finger feels the bar
    assert world.check(pressed, Scene(moving="RIGHT-ARM")) is not None
    assert world.check(pressed, Scene(moving="LEFT-ARM")) is None


def test_the_world_is_where_the_scene_says(world, right, home):
    """The module 45 mm aside of where the cell has it: a finger lands on its handle."""
    moved = geometry.translate(world.cell.object_pose("MACS-NEW"), (0, 0.040, 0))
    joints = right_at(right, home, *HANDLE)
    hit = world.check(joints, Scene(poses={"MACS-NEW": moved}))
    assert names(hit) == {"RIGHT-ARM finger_a", "MACS-NEW handle-a"}
    assert world.check(joints) is None  # and nothing of that scene is left in the next


def test_a_held_module_moves_with_the_hand_and_meets_its_rack(world, cell, right, home):
    in_hand = geometry.relative(level(*HANDLE), cell.object_pose("MACS-NEW"))
    scene = Scene(held={"MACS-NEW": Held("RIGHT-ARM", in_hand)}, openings_m={"RIGHT-ARM": 0.02})
    x, y, z = HANDLE
    assert world.check(right_at(right, home, x, y, z), scene) is None  # seated, 1.5 mm of play
    assert world.check(right_at(right, home, x, y, z + 0.15), scene) is None  # lifted out
    sideways = world.check(right_at(right, home, x, y + 0.01, z), scene)
    assert names(sideways) == {"MACS-NEW case", "RACK-1 left-wall"}
    down = world.check(right_at(right, home, x, y, z - 0.01), scene)
    assert names(down) == {"MACS-NEW case", "RACK-1 floor"}
    # The handle that is held is no obstacle to the fingers; the other arm's hand would be one.
    assert world.check(right_at(right, home, x, y, z), Scene()) is None


def test_a_seated_module_is_no_collision_with_its_seat(world, home):
    assert world.check(home) is None


def test_clearance_counts_for_neighbours_but_not_for_those_named_near(world, right, home):
    x, y, z = HANDLE
    joints = right_at(right, home, x - 0.10, y, z)  # tips 75 mm before the bar's face, and 30 mm beside it
    assert world.check(joints, Scene(clearance_m=0.05)) is None
    hit = world.check(joints, Scene(clearance_m=0.10))
    assert hit.body_b.startswith("MACS-NEW")
    assert hit.distance_m == pytest.approx(math.hypot(0.075, 0.030), abs=1e-4)
    assert world.check(joints, Scene(clearance_m=0.10, near=["MACS-NEW"])) is None


def test_the_arms_see_each_other(world, right, left, home):
    meet = level(0.55, 0.0, 0.95)
    joints = {"RIGHT-ARM": right.ik(meet, home["RIGHT-ARM"])[0], "LEFT-ARM": left.ik(meet, home["LEFT-ARM"])[0]}
    hit = world.check(joints)
    assert hit.body_a.startswith("RIGHT-ARM")
    assert hit.body_b.startswith("LEFT-ARM")


def test_an_arm_can_run_into_itself(world, home):
    folded = np.radians([0, -45, -225, 0, 0, 0])
    hit = world.check({**home, "RIGHT-ARM": folded})
    assert names(hit) == {"RIGHT-ARM pedestal", "RIGHT-ARM forearm"}


def test_a_region_is_solid_only_where_it_is_to_be_kept_out_of(world, right, home):
    region = world.cell.region("SOLAR-ARRAY").frame.xyz
    joints = right_at(right, home, 0.70, -0.30, region[2] - 0.05)
    assert world.check(joints) is None
    assert "SOLAR-ARRAY region" in names(world.check(joints, Scene(keep_out=["SOLAR-ARRAY"])))


def test_a_path_tells_its_first_hit(world, right, home):
    x, y, z = HANDLE
    ys = [y, y + 0.010, y + 0.029, y + 0.031, y + 0.040]  # the finger's inside touches from 30 mm on
    configurations = [right.ik(level(x, at, z), home["RIGHT-ARM"])[0] for at in ys]
    found = world.check_path("RIGHT-ARM", configurations, home)
    assert found.index == 3
    assert names(found.collision) == {"RIGHT-ARM finger_b", "MACS-NEW handle-a"}
    assert world.check_path("RIGHT-ARM", configurations[:3], home) is None


def across(right, home, *ys, x=HANDLE[0]):
    """Joints of the right hand LEVEL beside HANDLE-A, at these distances along y."""
    return [right.ik(level(x, HANDLE[1] + y, HANDLE[2]), home["RIGHT-ARM"])[0] for y in ys]


def test_a_way_may_leave_what_it_touches_at_its_start(world, right, home):
    """The finger's inside touches from 30 mm on: 5 mm deep at the start."""
    assert world.check_path("RIGHT-ARM", across(right, home, 0.035, 0.033, 0.020, 0.0), home) is None
    backwards = [across(right, home, 0.035, x=HANDLE[0] - back)[0] for back in (0.0, 0.02, 0.05, 0.10)]
    assert world.check_path("RIGHT-ARM", backwards, home) is None  # as deep as before, until it is out


def test_a_way_that_begins_inside_something_goes_no_deeper(world, right, home):
    found = world.check_path("RIGHT-ARM", across(right, home, 0.035, 0.036, 0.040), home)
    assert found.index == 1
    assert names(found.collision) == {"RIGHT-ARM finger_b", "MACS-NEW handle-a"}


@pytest.mark.parametrize("step", [0.020, 0.025, 0.030])
def test_a_way_that_begins_inside_a_bar_does_not_come_out_on_the_other_side(world, right, home, step):
    """Seen at its configurations alone the finger would be no deeper in the bar than before."""
    found = world.check_path("RIGHT-ARM", across(right, home, 0.035, 0.035 + step), home)
    assert found.index == 1


def test_what_has_been_left_is_not_touched_again(world, right, home):
    way = across(right, home, 0.035, 0.020, 0.032)
    assert world.check_path("RIGHT-ARM", way, home).index == 2
    assert world.check_path("RIGHT-ARM", across(right, home, 0.0, 0.032), home).index == 1  # nor by the next way


def test_what_is_nearer_than_the_clearance_at_the_start_comes_no_nearer(world, right, home):
    scene = Scene(clearance_m=0.05)
    away = [across(right, home, 0.0, x=HANDLE[0] - back)[0] for back in (0.10, 0.15, 0.20)]
    closer = [across(right, home, 0.0, x=HANDLE[0] - back)[0] for back in (0.06, 0.05)]
    assert world.check_path("RIGHT-ARM", away, home, scene) is None
    assert world.check({**home, "RIGHT-ARM": closer[0]}, scene) is not None
    assert world.check_path("RIGHT-ARM", closer[::-1], home, scene) is None
    assert world.check_path("RIGHT-ARM", closer, home, scene).index == 1


def test_a_refusal_names_the_bodies_and_what_would_clear_it(world, right, home):
    x, _, z = HANDLE
    refusal = world.check(right_at(right, home, x + 0.04, -0.80, z)).refusal("at the goal")
    assert isinstance(refusal.cause, causes.Collides)
    assert refusal.cause.body_b == "MACS-NEW case"
    assert refusal.cause.owners == ("RIGHT-ARM", "MACS-NEW")


def test_the_broad_phase_misses_nothing(world, arms):
    """Against pinocchio's plain walk over all pairs, over random postures, with and without clearance."""
    random = np.random.default_rng(9)
    bodies, hits = world._state.bodies, 0
    for scene in (Scene(), Scene(clearance_m=0.05)):
        for _ in range(150):
            joints = {name: random.uniform(arm.limits.lower, arm.limits.upper) for name, arm in arms.items()}
            found = world.check(joints, scene)
            world._state.tell_coal()
            plain = pin.computeCollisions(
                bodies.model, world._state.data, bodies.geometry, world._state.geometry_data, world._state.q, True
            )
            assert (found is not None) == plain
            hits += plain
    assert 20 < hits < 280  # both answers were seen


def test_every_arm_must_be_somewhere(world, home):
    with pytest.raises(ValueError, match="joints of LEFT-ARM are missing"):
        world.check({"RIGHT-ARM": home["RIGHT-ARM"]})


def test_a_search_finds_no_contact_that_a_path_check_does_not_find(world, right, home):
    random = np.random.default_rng(8)
    counted = 0
    for _ in range(60):
        ends = random.uniform(right.limits.lower, right.limits.upper, (2, 6))
        rows = ends[0] + np.linspace(0.0, 0.3, random.integers(2, 40))[:, None] * (ends[1] - ends[0])
        if world.check({**home, "RIGHT-ARM": rows[0]}) is not None:
            continue
        hit = world.check_path("RIGHT-ARM", rows, home)
        until = world.free_until("RIGHT-ARM", rows, home)
        assert until == len(rows) if hit is None else until >= hit.index  # a path check looks between the rows too
        counted += hit is not None
    assert counted > 5


def test_a_path_that_a_few_checks_show_to_be_blocked_has_a_collision(world, right, home):
    """Also if it begins in contact, which it may leave."""
    random = np.random.default_rng(9)
    blocked = touching = 0
    for _ in range(200):
        ends = random.uniform(right.limits.lower, right.limits.upper, (2, 6))
        rows = ends[0] + np.linspace(0.0, 0.3, random.integers(2, 40))[:, None] * (ends[1] - ends[0])
        if world.probe("RIGHT-ARM", rows, home):
            assert world.check_path("RIGHT-ARM", rows, home)
            blocked += 1
            touching += world.check({**home, "RIGHT-ARM": rows[0]}) is not None
    assert blocked > touching > 5


@pytest.mark.parametrize("boxes", [True, False])
def test_a_path_that_is_free_is_free_between_its_configurations_too(cell, right, home, boxes):
    """Random lines past everything, in steps of centimetres: the clearance holds at ten times as many."""
    scene, random = Scene(clearance_m=0.02), np.random.default_rng(5)
    world, near = CollisionWorld(cell, boxes=boxes), 0
    for _ in range(150):
        ends = random.uniform(right.limits.lower, right.limits.upper, (2, 6))
        rows = ends[0] + np.linspace(0.0, 0.1, random.integers(25, 40))[:, None] * (ends[1] - ends[0])
        free = world.check({**home, "RIGHT-ARM": rows[0]}, scene) is None
        if not free or world.check_path("RIGHT-ARM", rows, home, scene):
            continue
        fine = ends[0] + np.linspace(0.0, 0.1, 10 * len(rows))[:, None] * (ends[1] - ends[0])
        assert all(
            world.check({**home, "RIGHT-ARM": q}, replace(scene, clearance_m=0.02 - TOLERANCE_M)) is None for q in fine
        )
        near += any(world.check({**home, "RIGHT-ARM": q}, replace(scene, clearance_m=0.05)) for q in fine)
    assert near


@pytest.mark.parametrize("boxes", [True, False])
def test_a_laden_path_is_refused_where_the_pair_is_nearer_than_the_clearance_and_not_before(cell, right, home, boxes):
    """Random ways with a corner and a module in the hand. What is free up to the hit is so in finer steps too."""
    grasp = geometry.inverse((-0.15, -0.085, 0, 0, 0.5**0.5, 0, 0.5**0.5))
    scene = Scene(held={"MACS-NEW": Held("RIGHT-ARM", grasp)}, moving="RIGHT-ARM", clearance_m=0.013)
    random, refused, world = np.random.default_rng(12), 0, CollisionWorld(cell, boxes=boxes)
    for _ in range(40):
        corners = home["RIGHT-ARM"] + random.uniform(-0.6, 0.6, (3, 6))
        rows = np.vstack([a + np.linspace(0.0, 1.0, 60)[:, None] * (b - a) for a, b in itertools.pairwise(corners)])
        if world.check({**home, "RIGHT-ARM": rows[0]}, scene):
            continue
        hit = world.check_path("RIGHT-ARM", rows, home, scene)
        before = rows if hit is None else rows[: hit.index]
        fine = np.vstack([a + np.linspace(0.0, 1.0, 8)[:, None] * (b - a) for a, b in itertools.pairwise(before)])
        looser = replace(scene, clearance_m=0.013 - TOLERANCE_M)
        assert all(world.check({**home, "RIGHT-ARM": q}, looser) is None for q in fine)
        if hit is not None:
            refused += 1
            assert hit.collision.distance_m < hit.collision.margin_m
            last = rows[hit.index - 1] + np.linspace(0.0, 1.0, 50)[:, None] * (rows[hit.index] - rows[hit.index - 1])
            wider = replace(scene, clearance_m=0.013 + TOLERANCE_M)
            assert any(world.check({**home, "RIGHT-ARM": q}, wider) for q in last)
    assert 5 < refused < 35


def test_a_held_object_keeps_the_clearance_from_its_own_arm(world, right, home):
    """Also from the pedestal, but not from the links at the hand, which move with it."""
    grasp = geometry.inverse((-0.15, -0.085, 0, 0, 0.5**0.5, 0, 0.5**0.5))
    held = Scene(held={"MACS-NEW": Held("RIGHT-ARM", grasp)}, clearance_m=0.0)
    random, found = np.random.default_rng(3), []
    for q in random.uniform(right.limits.lower, right.limits.upper, (400, 6)):
        joints = {**home, "RIGHT-ARM": q}
        if world.check(joints, held) is None:
            found += world.too_near(joints, replace(held, clearance_m=0.03, ignore=[("MACS-NEW", "MACS-OLD")]))
    own = {hit.body_b for hit in found if hit.body_a.startswith("MACS-NEW") and hit.body_b.startswith("RIGHT-ARM")}
    own |= {hit.body_a for hit in found if hit.body_b.startswith("MACS-NEW") and hit.body_a.startswith("RIGHT-ARM")}
    assert "RIGHT-ARM pedestal" in own
    assert not own & {"RIGHT-ARM palm", "RIGHT-ARM sensor", "RIGHT-ARM flange"}


def test_the_spreads_of_two_bodies_add_up(world, home):
    scene = Scene(moving="RIGHT-ARM", clearance_m=0.005, pose_tolerance_m={"RACK-1": 0.02, "MACS-NEW": 0.03})
    held = replace(scene, held={"MACS-NEW": Held("RIGHT-ARM", (0.0, 0.0, 0.35, 0.0, 0.0, 0.0, 1.0))})
    for one in world.too_near(home, replace(held, clearance_m=2.0)):
        assert one.margin_m >= 0.005
    margins = {
        frozenset((hit.body_a.split()[0], hit.body_b.split()[0])): hit.margin_m
        for hit in world.too_near(home, replace(held, pose_tolerance_m={"RACK-1": 1.2, "MACS-NEW": 1.3}))
    }
    assert margins[frozenset(("RACK-1", "MACS-NEW"))] == pytest.approx(2.5)
