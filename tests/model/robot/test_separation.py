"""Two arms that both move: what is called apart never meets, with the compiled proof and without it."""

from __future__ import annotations

import numpy as np
import pytest

from rtc.model.cells.cell import Cell
from rtc.model.robot import compiled
from rtc.model.robot.collision import CollisionWorld
from rtc.model.robot.collision_scene import AS_BUILT, Held, Scene
from rtc.model.robot.separation import Interval, TwoWays
from rtc.spatial import geometry
from workers.planning.motion.beside import TimedPostures, waits

ARMS = ("RIGHT-ARM", "LEFT-ARM")
CELLS = ("swapout", "servicing", "truss")  # with two arms
IN_HAND = geometry.make_pose((0.0, 0.0, 0.15), geometry.LEVEL)
HELD = Scene(held={"MACS-NEW": Held("RIGHT-ARM", [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0])})
ROWS = 24  # of a way
NEAR_M = 0.01

needs_boxes = pytest.mark.skipif(not compiled(), reason="installed without a compiler")


@pytest.fixture(scope="module", params=CELLS)
def shadowed(request: pytest.FixtureRequest) -> CollisionWorld:
    return CollisionWorld(Cell.load(request.param))


def scenes(cell: Cell) -> list[Scene]:
    """Empty hands; each movable object in a hand."""
    arms, found = [arm.name for arm in cell.arms], [AS_BUILT]
    for n, thing in enumerate(one for one in cell.objects if not one.fixed):
        found.append(Scene(held={thing.name: Held(arms[n % 2], IN_HAND)}))
    return found


def way(world: CollisionWorld, arm: str, rng: np.random.Generator) -> np.ndarray:
    """A way between two random postures."""
    model, joints = world._state.bodies.model, world._state.bodies.arms[arm].joints
    low, high = model.lowerPositionLimit[joints], model.upperPositionLimit[joints]
    ends = rng.uniform(low, high, (2, len(joints)))
    return ends[0] + np.linspace(0.0, 1.0, ROWS)[:, None] * (ends[1] - ends[0])


def parts(rng: np.random.Generator, length: int) -> tuple[Interval, Interval]:
    first, second = rng.integers(0, ROWS - length, 2).tolist()
    return Interval(first, first + length), Interval(second, second + length)


def coal_alone(ways: TwoWays) -> TwoWays:
    return TwoWays(ways._check, *ways._ways, ways._clearance_m, None)


@needs_boxes
def test_no_parts_that_coal_refuses_are_called_apart(shadowed: CollisionWorld) -> None:
    """Of the middle of both parts, with the same margins; and between two neighbouring rows both agree."""
    rng, arms = np.random.default_rng(1), [arm.name for arm in shadowed.cell.arms[:2]]
    verdicts = {True: 0, False: 0}
    for scene in scenes(shadowed.cell):
        check = shadowed.compare_arms(arms[0], arms[1], scene)
        for _ in range(8):
            ways = check.ways(way(shadowed, arms[0], rng), way(shadowed, arms[1], rng), NEAR_M)
            for length in (1, 1, 1, 2, 4):
                two = parts(rng, length)
                found, coal_found = ways.open(0, *two) < 0, coal_alone(ways).open(0, *two) < 0
                assert coal_found or not found
                assert length > 1 or found == coal_found
                verdicts[found] += 1
    assert min(verdicts.values()) > 0


@needs_boxes
def test_what_is_proven_of_long_parts_holds_in_all_smaller_ones(shadowed: CollisionWorld) -> None:
    """The numbers of open pairs lose no pair that comes too near."""
    rng, arms = np.random.default_rng(2), [arm.name for arm in shadowed.cell.arms[:2]]
    check = shadowed.compare_arms(arms[0], arms[1], AS_BUILT)
    open_count = 0
    for _ in range(12):
        ways = check.ways(way(shadowed, arms[0], rng), way(shadowed, arms[1], rng), NEAR_M)
        known = ways.open(0, Interval(0, ROWS - 1), Interval(0, ROWS - 1))
        for _ in range(20):
            two = parts(rng, 1)
            apart = coal_alone(ways).open(0, *two) < 0
            assert apart if known < 0 else (ways.open(known, *two) < 0) == apart
            open_count += not apart
    assert open_count > 0


@needs_boxes
@pytest.mark.parametrize("cuts", [1, 8])
def test_the_waits_of_two_motions_are_the_same_without_boxes(cuts: int) -> None:
    rng, cell = np.random.default_rng(3), Cell.load("swapout")
    worlds = CollisionWorld(cell), CollisionWorld(cell, boxes=False)
    time_s, found = np.linspace(0.0, 3.0, ROWS), set()
    for _ in range(20):
        one, two = (TimedPostures(time_s, way(worlds[0], arm, rng)) for arm in ARMS)
        first, second = (waits(world.compare_arms(*ARMS, HELD), one, two, NEAR_M, cuts) for world in worlds)
        assert first == second
        found.add(None if first is None else bool(first))
    assert len(found) > 1


@pytest.mark.parametrize("scene", [AS_BUILT, HELD], ids=["empty", "holds"])
def test_two_arms_are_apart_if_their_nearest_pieces_are(world, arms, home, scene):
    """coal has a collision model of the two arms; the distances are those of the whole cell's."""
    random = np.random.default_rng(7)
    check = world.compare_arms(*ARMS, scene)
    carrier = world._state.table.carriers(scene)
    one, two = (carrier == world._state.table.number[arm] for arm in ARMS)
    pairs = np.flatnonzero(world._state.table.between(one, two)).tolist()
    found = set()
    for _ in range(12):
        y_m = random.uniform(-0.1, 0.1, 2)
        postures = [
            arms[arm].ik([0.48, y + side, 0.95, 0.0, 2**-0.5, 0.0, 2**-0.5], home[arm], 0.06)[0]
            for arm, y, side in zip(ARMS, y_m, (-0.1, 0.1), strict=True)
        ]
        world._state.update(dict(zip(ARMS, postures, strict=True)), scene)
        world._state.place()
        distance_m = min(world._state.describe(pair).distance_m for pair in pairs)
        for clearance_m in (0.01, 0.05):
            expected = distance_m > clearance_m
            assert check.apart(postures[0], np.zeros(6), postures[1], np.zeros(6), clearance_m) == expected
            found.add(expected)
    assert found == {True, False}
