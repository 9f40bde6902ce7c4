"""Boxes around the pieces of an arm: they hold every piece at every posture of their interval."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pybullet_data
import pytest

from rtc.model.robot.collision_scene import AS_BUILT, Held, Scene
from rtc.model.robot.swept import Boxes, Chain

ARMS = ("RIGHT-ARM", "LEFT-ARM")
HELD = Scene(held={"MACS-NEW": Held("RIGHT-ARM", [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0])})


@pytest.mark.parametrize("scene", [AS_BUILT, HELD], ids=["empty", "holds"])
def test_boxes_hold_each_piece_at_every_posture_of_the_interval(world, cell, scene):
    random = np.random.default_rng(4)
    check = world.compare_arms(*ARMS, scene)
    middles, turns = random.uniform(-2.0, 2.0, (6, 6)), random.uniform(0.0, 0.15, (6, 6))
    boxes = check.swept[0].boxes(middles, turns)
    model, geometry = world._state.bodies.model, world._state.bodies.geometry
    mine = np.flatnonzero(world._state.table.carriers(scene) == world._state.table.number["RIGHT-ARM"]).tolist()
    assert boxes.low.shape == (6, len(mine), 3)
    data, geometry_data, q = model.createData(), geometry.createData(), pin.neutral(model)
    for name, slots in world._state.bodies.arms.items():
        q[slots.fingers] = 0.5 * cell.arm(name).gripper.max_opening_m
    for n in range(6):
        for _ in range(20):
            q[world._state.bodies.arms["RIGHT-ARM"].joints] = middles[n] + random.uniform(-1.0, 1.0, 6) * turns[n]
            pin.updateGeometryPlacements(model, data, geometry, geometry_data, q)
            for at, piece in enumerate(mine):
                low, high = _extent(geometry.geometryObjects[piece].geometry, geometry_data.oMg[piece])
                assert (boxes.low[n, at] <= low + 1e-9).all()
                assert (boxes.high[n, at] >= high - 1e-9).all()


def _extent(solid: coal.CollisionGeometry, at: pin.SE3) -> tuple[np.ndarray, np.ndarray]:
    """Extent of the points of a box along the axes of the world; of another solid, that of a ball inside it."""
    if isinstance(solid, coal.Box):
        half = np.abs(at.rotation) @ np.array(solid.halfSide)
    else:
        half = np.full(3, solid.radius if hasattr(solid, "radius") else 0.0)
        if isinstance(solid, coal.Cylinder):
            half = np.full(3, min(solid.radius, solid.halfLength))
    return at.translation - half, at.translation + half


@pytest.mark.parametrize("kind", ["panda", "gantry"])
def test_the_chain_places_joints_as_pinocchio_does(cell, kind):
    model = pin.buildModelFromXML(_urdf(cell, kind))
    reference = pin.neutral(model)
    reference[-1] = 0.02  # a finger, which is not a joint of the chain
    joints = list(range(7))
    chain = Chain(model, joints, reference)
    postures = np.random.default_rng(1).uniform(-1.0, 1.0, (5, 7))
    places, data = chain.places(postures), model.createData()
    for n, posture in enumerate(postures):
        q = reference.copy()
        q[joints] = posture
        pin.forwardKinematics(model, data, q)
        for joint in range(model.njoints):
            number, at = chain.carried(joint, pin.SE3.Identity())
            assert np.allclose(places[number, n] @ at.homogeneous, data.oMi[joint].homogeneous, atol=1e-9)


def _urdf(cell, kind: str) -> str:
    if kind == "panda":
        return (Path(pybullet_data.getDataPath()) / "franka_panda" / "panda.urdf").read_text()
    slide = (
        '<link name="rail"/><joint name="rail_x" type="prismatic"><parent link="rail"/><child link="pedestal"/>'
        '<axis xyz="0.6 0 0.8"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint><link name="pedestal">'
    )
    return cell.urdf("RIGHT-ARM").replace('<link name="pedestal">', slide)


@pytest.mark.parametrize(("gap_m", "apart"), [(0.02, True), (0.005, False), (-0.3, False)])
def test_boxes_are_apart_if_one_axis_separates_each_pair(gap_m, apart):
    mine = Boxes(np.zeros((1, 3)), np.ones((1, 3)))
    at = np.array([[0.2, 1.0 + gap_m, 0.2]])
    theirs = Boxes(np.vstack((at, [[5.0, 0.0, 0.0]])), np.vstack((at + 0.3, [[6.0, 1.0, 1.0]])))
    assert mine.apart(theirs, 0.01) is apart
    assert theirs.apart(mine, 0.01) is apart


def test_a_box_around_several_intervals_holds_the_boxes_of_each():
    low = np.random.default_rng(2).uniform(-1.0, 0.0, (4, 2, 3))
    whole = Boxes(low, low + 1.0).between(1, 3)
    assert (whole.low == np.minimum(low[1], low[2])).all()
    assert (whole.high == np.maximum(low[1], low[2]) + 1.0).all()


@pytest.mark.parametrize("scene", [AS_BUILT, HELD], ids=["empty", "holds"])
def test_two_arms_are_apart_if_their_nearest_pieces_are(world, arms, home, scene):
    """The check has a collision model of its own; the distances are those of the whole cell's."""
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
