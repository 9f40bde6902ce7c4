"""What `check_path` calls free is free on the whole way, whatever lies between two configurations (decision 0081)."""

from __future__ import annotations

import itertools
import math

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Box, Frame, Object
from rtc.model.robot.collision import CollisionWorld, PathCollision
from rtc.model.robot.collision_scene import AttachedBody, Scene
from rtc.model.robot.kinematics import ArmModel

ARM = "RIGHT-ARM"
TOLERANCE_M = 1e-5
NEAR_M = 0.03  # a clearance


@pytest.fixture(params=[True, False], ids=["boxes", "coal"])
def boxes(request: pytest.FixtureRequest) -> bool:
    return bool(request.param)


def with_object(cell: Cell, name: str, size_m: tuple[float, float, float], at: list[float]) -> Cell:
    shape = Box(name="part", size_m=size_m)
    thing = Object(name=name, kind="obstacle", fixed=True, frame=Frame(xyz=tuple(at)), shapes=[shape])
    return msgspec.structs.replace(cell, objects=[*cell.objects, thing])


def one_step(cell: Cell, home: dict[str, list[float]]) -> np.ndarray:
    """Two configurations; the hand passes free space between them."""
    start = np.asarray(home[ARM], dtype=float)
    return np.array((start, start + 0.3 * np.eye(6)[0]))


def test_a_thin_rod_between_two_configurations_is_found(cell, right: ArmModel, home, boxes):
    rows = one_step(cell, home)
    between = right.fk(0.5 * (rows[0] + rows[1]))[:3]
    world = CollisionWorld(with_object(cell, "ROD", (0.002, 0.002, 0.002), between.tolist()), boxes=boxes)
    assert all(world.check({**home, ARM: q}) is None for q in rows)
    hit = world.check_path(ARM, rows, home)
    assert hit is not None
    assert hit.index == 1
    assert "ROD part" in (hit.collision.body_a, hit.collision.body_b)
    assert world.free_until(ARM, rows, home) == 1


def test_what_a_way_may_be_off_its_chord_counts(cell, right: ArmModel, home, boxes):
    """The tcp passes a body at some distance; on a way that may be farther off it could touch it."""
    rows = np.linspace(*one_step(cell, home), 5)
    world = CollisionWorld(cell, boxes=boxes)
    room_m = least_room_m(world, rows, home)
    assert room_m > 0.005
    straight, bent = np.zeros((4, 6)), np.full((4, 6), room_m)  # any point is some 0.5 to 2 m from some joint
    assert world.check_path(ARM, rows, home, off=straight) is None
    assert world.check_path(ARM, rows, home, off=bent) is not None


def least_room_m(world: CollisionWorld, rows: np.ndarray, home: dict[str, list[float]]) -> float:
    """The greatest clearance in steps of 5 mm with which the way is free."""
    for n in range(1, 60):
        if world.check_path(ARM, rows, home, Scene(moving=ARM, clearance_m=0.005 * n)):
            return 0.005 * (n - 1)
    raise AssertionError("nothing is near")


def test_another_body_is_found_between_two_configurations_while_a_contact_is_left(cell, right: ArmModel, home, boxes):
    """The hand is too near PLATE at the start and leaves it; on the same step it passes through ROD."""
    rows, scene = one_step(cell, home), Scene(moving=ARM, clearance_m=NEAR_M)
    start, between = (right.fk(q)[:3] for q in (rows[0], 0.5 * (rows[0] + rows[1])))
    away = (start - between) / np.linalg.norm(start - between)
    plated = with_object(cell, "PLATE", (0.004, 0.004, 0.004), (start + 2 * NEAR_M * away).tolist())
    free = CollisionWorld(plated, boxes=boxes)
    assert free.check({**home, ARM: rows[0]}, scene) is not None
    assert free.check_path(ARM, rows, home, scene) is None
    world = CollisionWorld(with_object(plated, "ROD", (0.002, 0.002, 0.002), between.tolist()), boxes=boxes)
    hit = world.check_path(ARM, rows, home, scene)
    assert hit is not None
    assert "ROD part" in (hit.collision.body_a, hit.collision.body_b)


def test_a_way_with_a_door_in_the_hand_is_free_between_its_configurations(boxes):
    """Of the arm everywhere, of the door at four places of each step."""
    cell = Cell.load("servicing")
    world, rng = CollisionWorld(cell, boxes=boxes), np.random.default_rng(4)
    door = next(thing for thing in cell.objects if thing.hinge is not None)
    arm, home = cell.arms[1].name, cell.object_pose(door.name)
    joints = {one.name: np.asarray(one.home_rad, dtype=float) for one in cell.arms}
    hung = AttachedBody(arm, home, (0.0, 0.0, -1.0), (0.0, math.radians(110.0)), door.grasp_points[0].frame.xyz)
    scene = Scene(moving=arm, attached={door.name: hung}, clearance_m=0.01, ignore=((door.name, "BAY-2"),))
    others = {piece.owner for piece in world._state.bodies.pieces} - {door.name}
    free = hits = 0
    for _ in range(30):
        start = rng.uniform(*world_limits(world, arm))
        rows = start + np.linspace(0.0, 1.0, 4)[:, None] * rng.uniform(-0.15, 0.15, len(start))
        hit = world.check_path(arm, rows, joints, scene)
        last = proven(rows, hit)
        free, hits = free + (hit is None), hits + (hit is not None)
        looser = replace(scene, clearance_m=0.01 - TOLERANCE_M)
        without = replace(looser, ignore=(*scene.ignore, *((door.name, one) for one in others)))
        for a, b in itertools.pairwise(last):
            for n in range(41):
                at = {**joints, arm: a + n / 40 * (b - a)}
                assert world.check(at, without if n % 10 else looser) is None
    assert free
    assert hits


def world_limits(world: CollisionWorld, arm: str) -> tuple[np.ndarray, np.ndarray]:
    slots, model = world._state.bodies.arms[arm].joints, world._state.bodies.model
    return model.lowerPositionLimit[slots], model.upperPositionLimit[slots]


def proven(rows: np.ndarray, hit: PathCollision | None) -> np.ndarray:
    return rows if hit is None else rows[: hit.index]


def test_a_sliding_pair_is_proven_without_steps_without_number(cell, right: ArmModel, home, boxes):
    """The only joint that turns brings nothing nearer that was not near."""
    start = np.asarray(home[ARM], dtype=float)
    rows = start + np.outer(np.linspace(0.0, math.pi / 2, 60), (0, 0, 0, 0, 0, 1))
    assert CollisionWorld(cell, boxes=boxes).check_path(ARM, rows, home, Scene(moving=ARM)) is None
