"""No point of a body moves farther than its levers say, and a group of configurations proven free is free."""

import itertools

import numpy as np
import pinocchio as pin
import pytest

from rtc.model.robot import bodies
from rtc.model.robot.boxes import STRAIGHT
from rtc.model.robot.collision import GROUP, CollisionWorld
from rtc.model.robot.collision_scene import AS_BUILT
from rtc.model.robot.levers import ball, levers, of_pairs


@pytest.fixture(scope="module")
def built(cell):
    return bodies.build(cell)


def corners(box):
    return np.array(list(itertools.product(*zip(box.min_, box.max_, strict=True))))


def places(built, q):
    """The corners of every piece in the world."""
    data, placed = built.model.createData(), built.geometry.createData()
    pin.updateGeometryPlacements(built.model, data, built.geometry, placed, q)
    items = built.geometry.geometryObjects
    return [
        corners(item.geometry.aabb_local) @ at.rotation.T + at.translation
        for item, at in zip(items, placed.oMg, strict=True)
    ]


def test_no_point_of_a_body_moves_farther_than_its_levers(built):
    rng = np.random.default_rng(3)
    items = built.geometry.geometryObjects
    bounds = np.array([levers(built.model, item.parentJoint, *ball(item.geometry, item.placement)) for item in items])
    low, high = built.model.lowerPositionLimit, built.model.upperPositionLimit
    for _ in range(50):
        here, there = rng.uniform(low, high), rng.uniform(low, high)
        there = here + rng.uniform(0.01, 0.5) * (there - here)
        most_m = bounds @ np.abs(there - here) + 1e-9
        for before, after, bound_m in zip(places(built, here), places(built, there), most_m, strict=True):
            assert np.linalg.norm(after - before, axis=1).max() <= bound_m


def test_a_joint_that_moves_both_bodies_does_not_change_their_distance():
    assert of_pairs(np.array([[0.5, 0.0]]), np.array([[0.9, 0.3]])).tolist() == [[0.0, 0.3]]


def test_a_group_that_is_proven_free_is_free(cell, home):
    """On random paths through the cell, near its bodies and far from them."""
    world, rng, groups = CollisionWorld(cell), np.random.default_rng(4), 0
    arm = cell.arm("RIGHT-ARM")
    slots = world._state.bodies.arms[arm.name].joints
    for _ in range(60):
        start = np.asarray(home[arm.name]) + rng.uniform(-1.2, 1.2, 6)
        path = start + np.outer(np.arange(30), rng.uniform(-0.025, 0.025, 6))
        world.check({**home, arm.name: start}, AS_BUILT)
        world._groups.widen(slots, path, GROUP, STRAIGHT)
        for n in range(1, len(path), GROUP):
            group = path[n : n + GROUP]
            world._state.q[slots] = group[len(group) // 2]
            if not world._groups.touches_any():
                groups += 1
                assert all(world.check({**home, arm.name: q}, AS_BUILT) is None for q in group)
    assert groups > 100
