"""Motions beside each other: when one may start so that the two cannot meet, whatever stops either of them."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from rtc.model.robot import compiled
from rtc.model.robot.collision_scene import Scene
from rtc.protocol.outcomes import Refused, StopReason
from rtc.protocol.primitive import (
    MAX_FURTHER,
    MAX_S,
    Box,
    Compliance,
    ControlLaw,
    GoalReached,
    JointTrajectory,
    Primitive,
    StartAfter,
    StopFunction,
    TimeAbove,
    apart,
)
from tests.workers.conftest import CELL, MODEL
from tests.workers.refusals import refusal_of
from workers.planning.motion.beside import SPACE_M, course, space_of, start_conditions, waits
from workers.planning.motion.path import joint_line
from workers.planning.motion.request import PlanningRequest
from workers.planning.motion.timing import time_path

RIGHT, LEFT = "RIGHT-ARM", "LEFT-ARM"
F = [
    StopFunction(reason=StopReason.GOAL, when=GoalReached()),
    StopFunction(reason=StopReason.TIMEOUT, when=TimeAbove(60.0)),
]
HOME = {arm.name: np.array(arm.home_rad) for arm in CELL.arms}
SCENE = Scene()


def at(arm: str, y_m: float, x_m: float = 0.48) -> np.ndarray:
    """The posture of the hand pointing to the bay, nearest to home."""
    return np.asarray(MODEL.arms[arm].ik([x_m, y_m, 0.95, 0.0, 2**-0.5, 0.0, 2**-0.5], HOME[arm], 0.06)[0])


def motion(arm: str, start: np.ndarray, goal: np.ndarray, id: str = "C-1.1") -> Primitive:
    timed = time_path(MODEL.arms[arm], joint_line(start, goal))
    return Primitive(id=id, performer=arm, trajectory=timed.trajectory(), stop_functions=F)


def conditions(mine: Primitive, theirs: Primitive, *, follows: bool = False) -> list[StartAfter]:
    start = {mine.performer: mine.trajectory.positions[0], theirs.performer: theirs.trajectory.positions[-1]}
    request = PlanningRequest(MODEL.arms[mine.performer], MODEL.collision, start, SCENE)
    return start_conditions(request, mine, [theirs], follows=follows)


INTO = motion(RIGHT, at(RIGHT, -0.4), at(RIGHT, 0.1))  # into the middle
OUT = motion(RIGHT, at(RIGHT, 0.1), at(RIGHT, -0.4))
MINE = motion(LEFT, at(LEFT, 0.4), at(LEFT, 0.0), "C-2.1")


def space(motion: Primitive) -> list[Box]:
    return space_of(PlanningRequest(MODEL.arms[motion.performer], MODEL.collision, HOME, SCENE), motion)


@pytest.mark.skipif(not compiled(), reason="spaces are computed by the compiled kernel")
def test_motions_with_spaces_apart_have_no_start_condition_and_those_that_meet_are_not_apart():
    random, apart_count = np.random.default_rng(5), 0
    for _ in range(30):
        y = random.uniform(-0.45, 0.45, 4)
        mine = motion(LEFT, at(LEFT, max(y[0], -0.1)), at(LEFT, max(y[1], -0.1)), "C-2.1")
        theirs = motion(RIGHT, at(RIGHT, min(y[2], 0.1)), at(RIGHT, min(y[3], 0.1)))
        if apart(space(mine), space(theirs)):
            apart_count += 1
            assert conditions(mine, theirs) == []  # found by the search: mine has no space here
    assert 0 < apart_count < 30


@pytest.mark.skipif(not compiled(), reason="spaces are computed by the compiled kernel")
def test_motions_with_spaces_apart_are_not_searched(monkeypatch):
    monkeypatch.setattr("workers.planning.motion.beside.waits", None)
    theirs = motion(RIGHT, at(RIGHT, -0.4), at(RIGHT, -0.3))
    mine = motion(LEFT, at(LEFT, 0.4), at(LEFT, 0.3), "C-2.1")
    assert conditions(msgspec.structs.replace(mine, space_mm=space(mine)), theirs) == []


def test_motions_that_do_not_meet_start_at_once():
    theirs = motion(RIGHT, at(RIGHT, -0.4), at(RIGHT, -0.3))
    assert conditions(MINE, theirs) == []


def test_a_motion_waits_until_the_other_arm_has_left_its_path():
    (condition,) = conditions(MINE, OUT)
    assert condition.primitive == "C-1.1"
    assert 0.0 < condition.path_s < OUT.trajectory.duration_s


def test_a_motion_to_where_the_other_arm_goes_is_refused_and_names_that_arm():
    refusal = refusal_of(conditions, MINE, INTO)
    assert (refusal.in_the_way, refusal.owner) == (RIGHT, "C-1")


def test_an_arm_that_may_back_off_must_reach_its_goal_first():
    stops = [*F, StopFunction(reason=StopReason.FORCE_LIMIT, when=TimeAbove(50.0), back_off_m=0.02)]
    (condition,) = conditions(MINE, msgspec.structs.replace(OUT, stop_functions=stops))
    assert condition.path_s == MAX_S


def test_a_soft_arm_needs_more_space():
    law = ControlLaw(name="impedance", compliance=Compliance(stiffness=[200.0] * 3 + [10.0] * 3, most_n=10.0))
    (stiff,), (soft,) = conditions(MINE, OUT), conditions(MINE, msgspec.structs.replace(OUT, control_law=law))
    assert soft.path_s > stiff.path_s


@pytest.mark.parametrize("seed", range(4))
def test_no_posture_of_a_motion_meets_what_the_other_has_before_it(seed):
    """The answer holds for random pairs of postures, whatever the timing; and it is not needlessly late."""
    random = np.random.default_rng(seed)
    y = random.uniform(0.0, 0.1, 4)
    mine = motion(LEFT, at(LEFT, 0.35 + y[0]), at(LEFT, y[1]), "C-2.1").trajectory
    theirs = motion(RIGHT, at(RIGHT, y[2]), at(RIGHT, -0.4 - y[3])).trajectory
    check = MODEL.collision.compare_arms(LEFT, RIGHT, SCENE)
    courses = [course(path, reach) for path, reach in zip((mine, theirs), check.reaches, strict=True)]
    found = waits(check, courses[0], courses[1], SPACE_M)
    assert found is not None
    free_s = max((wait.until_s for wait in found), default=0.0)
    for _ in range(300):
        one = _at(mine, random.uniform(0.0, mine.duration_s))
        other = _at(theirs, random.uniform(free_s, theirs.duration_s))
        assert MODEL.collision.check({LEFT: one, RIGHT: other}, Scene(moving=LEFT)) is None
    if seed:  # the hands cross
        assert free_s > 0.0
        earlier = _at(theirs, max(0.0, free_s - 0.25))
        path = np.array([_at(mine, t) for t in np.linspace(0.0, mine.duration_s, 200)])
        assert MODEL.collision.check_path(LEFT, path, {RIGHT: earlier}, Scene(moving=LEFT, clearance_m=0.08))


@pytest.mark.parametrize("seed", range(6))
def test_no_posture_on_the_way_meets_what_the_other_has_before_it_then(seed):
    """With the conditions on the way, for random pairs of postures; and it starts earlier than without them."""
    random = np.random.default_rng(seed)
    y = random.uniform(0.0, 0.1, 4)
    theirs = motion(RIGHT, at(RIGHT, y[0]), at(RIGHT, -0.4 - y[1]))
    mine = motion(LEFT, at(LEFT, 0.4 + y[2]), at(LEFT, -y[3]), "C-2.1")
    (apart_s,) = conditions(mine, theirs)
    (close,) = conditions(mine, theirs, follows=True)
    assert close.path_s < apart_s.path_s
    assert apart_s.further == []
    assert 0 < len(close.further) < MAX_FURTHER
    assert close.needed_s(mine.trajectory.duration_s) == pytest.approx(apart_s.path_s)
    for _ in range(300):
        my_s = random.uniform(0.0, mine.trajectory.duration_s)
        their_s = random.uniform(min(close.needed_s(my_s), theirs.trajectory.duration_s), theirs.trajectory.duration_s)
        joints = {LEFT: _at(mine.trajectory, my_s), RIGHT: _at(theirs.trajectory, their_s)}
        assert MODEL.collision.check(joints, Scene(moving=LEFT)) is None


def test_a_motion_waits_for_the_whole_of_one_that_may_back_off():
    stops = [*F, StopFunction(reason=StopReason.FORCE_LIMIT, when=TimeAbove(50.0), back_off_m=0.02)]
    (condition,) = conditions(MINE, msgspec.structs.replace(OUT, stop_functions=stops), follows=True)
    assert (condition.path_s, condition.further) == (MAX_S, [])


def test_what_is_not_decided_in_time_is_waited_for(monkeypatch):
    (decided,) = conditions(MINE, OUT, follows=True)
    for checks in (20, 60, 150, 400):
        monkeypatch.setattr("workers.planning.motion.beside.MAX_CHECKS", checks)
        try:
            (found,) = conditions(MINE, OUT, follows=True)
        except Refused:
            continue
        for my_s in np.linspace(0.0, MINE.trajectory.duration_s, 50).tolist():
            assert found.needed_s(my_s) >= min(decided.needed_s(my_s), found.path_s)
    assert found.path_s < MAX_S


def _at(path: JointTrajectory, time_s: float) -> np.ndarray:
    positions = np.asarray(path.positions)
    return np.array([np.interp(time_s, path.time_s, column) for column in positions.T])
