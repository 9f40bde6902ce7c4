"""RRT-Connect of a point in a square: round walls, to the goal that can be reached, the same for the same seed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from workers.planning.motion.sampling import NARROW, WIDE, Found, Trees, search, shorten

LOWER, UPPER, WEIGHTS = np.full(2, -3.0), np.full(2, 3.0), np.ones(2)
START, GOAL = np.array([-2.0, 0.0]), np.array([2.0, 0.0])
STEP = 0.02


def steering(free):
    """Straight lines, tested at small steps."""

    def steer(here, there):
        count = max(1, int(np.ceil(np.abs(there - here).max() / STEP)))
        rows = here + (np.arange(count + 1) / count)[:, None] * (there - here)
        good = next((n for n, row in enumerate(rows) if not free(*row)), count + 1)
        if good > count:
            return [there.copy()], True
        return ([rows[good - 1]] if good > 1 else []), False

    return steer


def beside_a_wall(x, y):
    """A wall with a gap at the top."""
    return not (-0.2 < x < 0.2 and y < 1.5)


def find(free, goals=(GOAL,), seed=1, samples=1000, project=lambda q: q, **more):
    trees = Trees(START, goals, steering(free), WEIGHTS, project)
    return search(trees, np.vstack([START, *goals]), LOWER, UPPER, seed=seed, samples=samples, **more)


def length(path):
    return sum(float(np.linalg.norm(b - a)) for a, b in pairwise(path))


@pytest.mark.parametrize("seed", range(6))
def test_a_way_round_a_wall_is_found_and_shortened(seed):
    found = find(beside_a_wall, seed=seed)
    assert isinstance(found, Found)
    steer = steering(beside_a_wall)
    short = shorten(found.waypoints, steer, WEIGHTS, seed=seed)
    for path in (found.waypoints, short):
        assert np.array_equal(path[0], START)
        assert np.array_equal(path[-1], GOAL)
        assert all(steer(a, b)[1] for a, b in pairwise(path))
    assert length(short) <= length(found.waypoints) + 1e-9
    assert length(short) < 1.3 * 2 * np.hypot(2.0, 1.5)


def test_the_seed_alone_decides():
    a, b, c = (find(beside_a_wall, seed=seed) for seed in (5, 5, 6))
    assert np.array_equal(a.waypoints, b.waypoints)
    assert a.samples == b.samples
    assert not np.array_equal(a.waypoints, c.waypoints)


def test_of_several_goals_the_one_that_can_be_reached_is_taken():
    def free(x, y):
        return not (0.5 < max(abs(x - 2.0), abs(y)) < 0.7)  # a closed ring around GOAL

    found = find(free, goals=(GOAL, np.array([0.0, 2.0])))
    assert found.goal == 1
    assert np.array_equal(found.waypoints[-1], [0.0, 2.0])


def test_a_goal_behind_a_closed_wall_costs_the_budget():
    assert find(lambda x, y: not -0.2 < x < 0.2, samples=150) == 150


def test_a_goal_without_any_room_ends_the_search_early():
    assert find(lambda x, y: max(abs(x - 2.0), abs(y)) > 0.5 or (x, y) == (2.0, 0.0), samples=5000) == WIDE.stuck_after


def test_guides_come_before_random_samples():
    over = [np.array([-0.5, 1.8]), np.array([0.5, 1.8])]
    found = find(beside_a_wall, guides=over)
    assert found.samples <= 2
    assert any(np.array_equal(point, over[0]) for point in found.waypoints)


def test_samples_that_no_projection_brings_onto_the_constraint_are_left_out():
    assert find(beside_a_wall, samples=40, project=lambda q: None) == 40


def test_two_joints_lead_out_of_a_place_where_the_others_have_no_room():
    ends = np.zeros((2, 6))
    ends[1, 1:3] = 2.0

    def free(*q):
        """A slot that bends: joint 1 and joint 2 together, all others where they are."""
        others = max(abs(q[n]) for n in (0, 3, 4, 5))
        return others < 0.01 and abs(q[1] - q[2]) < 0.3 if q[1] < 0.6 else True

    def samples(draw):
        trees = (Trees(ends[0], ends[1:], steering(free), np.ones(6)) for _ in range(8))
        lower, upper = np.full(6, -3.0), np.full(6, 3.0)
        found = [search(one, ends, lower, upper, seed=n, samples=600, draw=draw) for n, one in enumerate(trees)]
        return sum(isinstance(one, Found) for one in found)

    assert samples(NARROW) == 8
    assert samples(WIDE) < 8
