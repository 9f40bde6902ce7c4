"""Boxes never call a pair apart that coal finds too near, and they decide most of what is free."""

from __future__ import annotations

import itertools
import os
import shutil
import subprocess
from collections.abc import Iterator

import coal
import numpy as np
import pytest

from rtc.model.cells.cell import Cell
from rtc.model.robot import compiled
from rtc.model.robot.boxes import STRAIGHT
from rtc.model.robot.collision import CollisionWorld
from rtc.model.robot.collision_scene import AttachedBody, Held, Scene
from rtc.model.robot.kinematics import ArmModel
from rtc.spatial import geometry

CELLS = ("swapout", "servicing", "panda", "gantry")
IN_HAND = geometry.make_pose((0.0, 0.0, 0.15), geometry.LEVEL)
STEPS = 40  # of a way
TIGHTER_M = 0.05
MAX_UNDECIDED = 0.05  # pairs in a free posture, on average

needs_boxes = pytest.mark.skipif(not compiled(), reason="installed without a compiler")


@pytest.fixture(scope="module", params=CELLS)
def shadowed(request: pytest.FixtureRequest) -> CollisionWorld:
    return CollisionWorld(Cell.load(request.param))


@pytest.fixture(scope="module")
def coal_alone() -> CollisionWorld:
    return CollisionWorld(Cell.load("swapout"), boxes=False)


def scenes(cell: Cell) -> list[Scene]:
    """Of the first arm: empty hand; with clearances; with each movable object in the hand; at each hinge."""
    arm = cell.arms[0].name
    found = [Scene(), Scene(moving=arm, clearance_m=0.02, pose_tolerance_m={cell.arms[-1].name: 0.01})]
    for thing in cell.objects:
        if not thing.fixed:
            found.append(Scene(moving=arm, clearance_m=0.005, held={thing.name: Held(arm, IN_HAND)}))
    return found


def postures(world: CollisionWorld, rng: np.random.Generator) -> dict[str, np.ndarray]:
    low, high = world._state.bodies.model.lowerPositionLimit, world._state.bodies.model.upperPositionLimit
    slots = {name: one.joints for name, one in world._state.bodies.arms.items()}
    return {name: rng.uniform(low[joints], high[joints]) for name, joints in slots.items()}


def coal_finds(world: CollisionWorld) -> bool:
    """What coal says of the present configuration without boxes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world._state, "boxes", None)
        return world._state.touches_any()


def test_with_a_compiler_the_boxes_are_compiled() -> None:
    compiler = shutil.which(os.environ.get("CXX", "c++"))
    works = compiler is not None and not subprocess.run([compiler, "--version"], capture_output=True).returncode
    assert compiled() or not works


@needs_boxes
def test_no_posture_that_coal_refuses_is_called_apart(shadowed: CollisionWorld) -> None:
    rng, free, undecided = np.random.default_rng(1), 0, 0
    for scene in scenes(shadowed.cell):
        for _ in range(150):
            shadowed._state.update(postures(shadowed, rng), scene)
            state = shadowed._state
            near, hit = state.boxes.undecided(state.q, state.varying), coal_finds(shadowed)
            assert near or not hit
            if not hit:
                free, undecided = free + 1, undecided + len(near)
    assert free > 0
    assert undecided < MAX_UNDECIDED * free


@needs_boxes
def test_margins_that_are_too_small_would_be_noticed(shadowed: CollisionWorld) -> None:
    """The test above can fail: boxes with smaller margins call postures apart that coal refuses."""
    rng, wrong = np.random.default_rng(2), 0
    scene = Scene(clearance_m=TIGHTER_M)
    for _ in range(300):
        shadowed._state.update(postures(shadowed, rng), scene)
        state = shadowed._state
        pairs, boxes = state.pairs, state.boxes
        boxes.use(pairs.numbers, pairs.margin[pairs.numbers] - TIGHTER_M)
        wrong += not boxes.undecided(state.q, state.varying) and coal_finds(shadowed)
        boxes.use(pairs.numbers, pairs.margin[pairs.numbers])
    assert wrong > 0


@needs_boxes
def test_no_posture_on_a_way_that_is_proven_free_is_refused_by_coal(shadowed: CollisionWorld) -> None:
    """Nor between its rows. The parts that are not proven hold the pair that is too near."""
    rng, proven = np.random.default_rng(3), 0
    arm = shadowed.cell.arms[0].name
    slots = shadowed._state.bodies.arms[arm].joints
    for scene, _ in itertools.product(scenes(shadowed.cell)[:4], range(12)):
        others = postures(shadowed, rng)
        rows = others[arm] + np.linspace(0.0, 1.0, 6)[:, None] * rng.uniform(-0.4, 0.4, len(slots))
        shadowed._state.update({**others, arm: rows[0]}, scene)
        free, near = shadowed._state.boxes.way(shadowed._state.q, slots, rows, 0)
        assert bool(near) == (free < len(rows) - 1)
        proven += free
        for place in np.linspace(0.0, free, STEPS if free else 1)[: STEPS if free else 0]:
            shadowed._put(slots, rows, place)
            assert not coal_finds(shadowed)
    assert proven > 0


@needs_boxes
def test_a_door_in_the_hand_is_where_the_hand_has_turned_it() -> None:
    cell = Cell.load("servicing")
    world, rng = CollisionWorld(cell), np.random.default_rng(4)
    door = next(thing for thing in cell.objects if thing.hinge is not None)
    assert door.hinge is not None
    arm, home = cell.arms[1].name, cell.object_pose(door.name)
    hung = AttachedBody(arm, home, (0.0, 0.0, 1.0), (0.0, 2.0), (0.0, 0.4, 0.0))
    scene = Scene(moving=arm, attached={door.name: hung})
    for _ in range(200):
        world._state.update(postures(world, rng), scene)
        world._state.turn_attached(scene)
        assert world._state.boxes.undecided(world._state.q, world._state.varying) or not coal_finds(world)


@needs_boxes
def test_paths_have_the_same_verdicts_without_boxes(coal_alone: CollisionWorld) -> None:
    """The same paths are free, searches stop at the same configuration, and a hit names the same bodies."""
    with_boxes = CollisionWorld(coal_alone.cell)
    rng, hits = np.random.default_rng(5), 0
    for number in range(120):
        others = {arm.name: np.asarray(arm.home_rad) for arm in coal_alone.cell.arms}
        rows = others["RIGHT-ARM"] + np.outer(np.arange(50), rng.uniform(-0.02, 0.02, 6))
        scene = Scene(moving="RIGHT-ARM", clearance_m=0.005 * (number % 3))
        found, expected = (one.check_path("RIGHT-ARM", rows, others, scene) for one in (with_boxes, coal_alone))
        assert (found is None) == (expected is None)
        if found is not None and expected is not None:
            hits += 1
            assert found.index == expected.index
            assert {found.collision.body_a, found.collision.body_b} == {
                expected.collision.body_a,
                expected.collision.body_b,
            }
        assert expected is None or not with_boxes.proves("RIGHT-ARM", rows, others, scene, STRAIGHT)
        assert with_boxes.free_until("RIGHT-ARM", rows, others, scene) == coal_alone.free_until(
            "RIGHT-ARM", rows, others, scene
        )
    assert 10 < hits < 110


@needs_boxes
def test_the_space_of_a_way_contains_all_that_moves_on_it(shadowed):
    rng = np.random.default_rng(9)
    for scene in scenes(shadowed.cell):
        start, goal = postures(shadowed, rng), postures(shadowed, rng)
        for arm in start:
            rows = start[arm] + np.linspace(0.0, 1.0, 5)[:, None] * (goal[arm] - start[arm])
            boxes = shadowed.space(arm, rows, scene)
            assert boxes is not None
            for share in rng.uniform(0.0, 1.0, 10):
                shadowed._state.update({**start, arm: start[arm] + share * (goal[arm] - start[arm])}, scene)
                for piece, box in zip(coal_pieces(shadowed, arm, scene), boxes, strict=True):
                    assert least_room_m(*piece, box) > -1e-6


def coal_pieces(
    world: CollisionWorld, arm: str, scene: Scene
) -> Iterator[tuple[coal.CollisionGeometry, coal.Transform3s]]:
    """The solids of an arm and of what it holds, with their present placements."""
    bodies = world._state.bodies
    world._state.place()
    for n in np.flatnonzero(world._state.table.carriers(scene) == world._state.table.number[arm]).tolist():
        at = world._state.geometry_data.oMg[n]
        yield bodies.geometry.geometryObjects[n].geometry, coal.Transform3s(at.rotation, at.translation)


def least_room_m(solid: coal.CollisionGeometry, at: coal.Transform3s, box: np.ndarray) -> float:
    """The least distance of a solid from the outside of a box [6], behind each of its six faces."""
    found = []
    for axis, unit in enumerate(np.eye(3)):
        for outside in (coal.Halfspace(unit, box[axis]), coal.Halfspace(-unit, -box[axis + 3])):
            result = coal.DistanceResult()
            found.append(coal.distance(solid, at, outside, coal.Transform3s(), coal.DistanceRequest(), result))
    return min(found)


@needs_boxes
@pytest.mark.parametrize("name", CELLS)
def test_a_posture_is_turned_to_an_attitude_as_by_pinocchio(name, monkeypatch):
    cell = Cell.load(name)
    rng, found = np.random.default_rng(6), 0
    for arm in (ArmModel.of(cell, one.name) for one in cell.arms):
        for _ in range(60):
            q = rng.uniform(arm.limits.lower, arm.limits.upper)
            attitude = geometry.from_rpy((0.0, 0.0, 0.0), rng.uniform(-3.0, 3.0, 3))
            ours = arm.turned_to(attitude, q)
            with monkeypatch.context() as patch:
                patch.setattr(arm, "_compiled", None)
                theirs = arm.turned_to(attitude, q)
            assert (ours is None) == (theirs is None)
            if ours is not None and theirs is not None:
                found += 1
                assert np.allclose(ours, theirs, atol=1e-6)
                assert geometry.angle(arm.fk(ours), attitude) < 2e-3
    assert found > 20


@needs_boxes
def test_the_compiled_closed_form_finds_what_the_python_one_finds(monkeypatch):
    cell = Cell.load("swapout")
    rng, lengths = np.random.default_rng(11), set()
    for arm in (ArmModel.of(cell, one.name) for one in cell.arms):
        for n in range(150):
            q, near = rng.uniform(arm.limits.lower, arm.limits.upper, (2, 6))
            if n % 5 == 0:
                q[4] = 0.0  # a straight wrist
            begin, end = arm.fk(q), arm.fk(q + rng.normal(0.0, 0.3, 6))
            if n % 10 == 9:
                end[:3] += (0.0, 0.0, 2.0)  # out of reach
            ours = _solved(arm, begin, end, near, 0.05 * (n % 3))
            with monkeypatch.context() as patch:
                patch.setattr(arm, "_puma", None)
                theirs = _solved(arm, begin, end, near, 0.05 * (n % 3))
            for mine, other in zip(ours, theirs, strict=True):
                assert len(mine) == len(other)
                assert not len(mine) or np.allclose(mine, other, atol=1e-9)
            lengths |= {len(ours[0]), len(ours[1]), len(ours[2])}
    assert {0, 4, 8, 9} <= lengths


def _solved(arm, begin, end, near, margin_rad):
    line = arm.ik_line(begin, end, np.linspace(0.05, 1.0, 9), near)
    return arm.ik(begin, near, margin_rad), arm.ik(end, near), line
