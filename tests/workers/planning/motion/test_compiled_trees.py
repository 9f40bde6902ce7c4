"""The compiled trees of a search: their ways are free by coal alone, keep limits and attitude, and repeat by seed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from benchmarks.load.planning_queries import Queries
from rtc.model.robot import compiled
from rtc.model.robot.collision import CollisionWorld
from tests.workers.conftest import MODEL
from workers.planning.motion.path import joint_line
from workers.planning.motion.request import is_free
from workers.planning.motion.sampled_way import _Space
from workers.planning.motion.sampling import Found, Trees, search

pytestmark = pytest.mark.skipif(not compiled(), reason="installed without a compiler")
ALONE = CollisionWorld(MODEL.cell, boxes=False)
LEVEL_RAD = 0.05  # tolerance of an attitude halfway between two postures that keep it


def blocked(arm: str, attitude: str = "", count: int = 3):
    """Queries whose line in joint space is not free."""
    drawn = Queries(MODEL, arm, 7, attitude).take(60)
    found = [q for q in drawn if not is_free(q.request, joint_line(q.request.start, q.goal))]
    return found[:count]


def ways(query, trees_of):
    space = _Space(query.request)
    trees, ends = trees_of(space, [query.goal]), np.vstack([query.request.start, query.goal])
    return trees, search(trees, ends, *space.limits, seed=3, samples=600)


def of_python(space, goals):
    return Trees(space._start, goals, space._straight, space.weights)


@pytest.mark.parametrize("arm", MODEL.arms)
def test_each_line_of_a_way_is_free_by_coal_alone(arm):
    for query in blocked(arm):
        request = query.request
        trees, found = ways(query, _Space.trees)
        assert not isinstance(trees, Trees)
        assert isinstance(found, Found)
        assert np.array_equal(found.waypoints[0], request.start)
        assert np.array_equal(found.waypoints[-1], query.goal)
        for here, there in pairwise(found.waypoints):
            rows = np.linspace(here, there, 40)
            assert ALONE.free_until(arm, rows, request.joints, request.scene) == len(rows)
        _, again = ways(query, _Space.trees)
        assert np.array_equal(again.waypoints, found.waypoints)


def test_a_shortcut_is_free_by_coal_alone():
    rng = np.random.default_rng(6)
    arrivals = []
    for query in blocked("RIGHT-ARM"):
        request, space = query.request, _Space(query.request)
        trees = space.trees([query.goal])
        for near in rng.uniform(-0.6, 0.6, (30, 6)):
            there = np.clip(request.start + near, *space.limits)
            reached, arrived = trees.steer(request.start, there)
            rows = np.linspace(request.start, there, 40)
            free = ALONE.free_until("RIGHT-ARM", rows, request.joints, request.scene) == len(rows)
            assert free or not arrived
            assert not arrived or np.array_equal(reached, [there])
            arrivals.append((arrived, free))
    assert {(True, True), (False, False)} <= set(arrivals)


def test_both_kinds_of_trees_find_a_way_where_there_is_one():
    for query in blocked("RIGHT-ARM", count=4):
        found = [isinstance(ways(query, trees)[1], Found) for trees in (_Space.trees, of_python)]
        assert found == [True, True]


def test_way_points_keep_the_attitude_and_the_limits():
    attitude = next(iter(MODEL.cell.attitudes))
    queries = blocked("LEFT-ARM", attitude)
    assert queries
    reached = 0
    for query in queries:
        space = _Space(query.request)
        _, found = ways(query, _Space.trees)
        for q in found.waypoints if isinstance(found, Found) else []:
            turned = space.project(q)
            assert np.abs(turned - q).max() < LEVEL_RAD
            assert (q >= space.limits[0] - 1e-9).all()
            assert (q <= space.limits[1] + 1e-9).all()
            reached += 1
    assert reached


def test_an_end_that_is_not_free_is_left_to_the_trees_of_python():
    query = next(iter(Queries(MODEL, "RIGHT-ARM", 7).take(1)))
    inside = query.request.arm.ik(MODEL.cell.object_pose("SATELLITE"), query.request.start)
    for goal in inside[:1]:
        assert isinstance(_Space(query.request).trees([goal]), Trees)
