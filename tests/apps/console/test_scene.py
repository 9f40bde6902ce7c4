"""Bodies of any cell and their poses, against the kinematics that plan motions; and the bytes of a frame."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from rtc.apps.console.pose_frame import HEADER, TRUE, pack
from rtc.apps.console.scene import SceneBodies
from rtc.drawing.scene import SceneView
from rtc.model.cells.cell import Cell
from rtc.model.robot.kinematics import ArmModel
from rtc.spatial import geometry


@pytest.mark.parametrize("name", ["swapout", "panda", "gantry"])
def test_the_links_are_where_the_kinematics_has_them(name):
    cell = Cell.load(name)
    bodies = SceneBodies(cell)
    rng = np.random.default_rng(3)
    for arm in cell.arms:
        model = ArmModel.of(cell, arm.name)
        joints = (np.array(arm.home_rad) + rng.uniform(-0.1, 0.1, len(arm.joints))).tolist()
        poses = np.array(bodies.poses(SceneView(joints={arm.name: joints}))).reshape(-1, 7)
        tcp = next(n for n, row in enumerate(bodies.rows) if row.name == f"{arm.name}/{arm.tcp_link}")
        assert geometry.distance(poses[tcp], model.fk(joints)) < 1e-9
        assert geometry.angle(poses[tcp], model.fk(joints)) < 1e-7


@pytest.mark.parametrize("name", ["swapout", "panda", "gantry"])
def test_every_arm_has_something_to_draw_without_a_mesh_from_elsewhere(name):
    bodies = SceneBodies(Cell.load(name))
    for arm in bodies.cell.arms:
        shapes = [shape for row in bodies.rows if row.owner == arm.name for shape in row.shapes]
        assert len(shapes) >= len(arm.joints)
        for shape in shapes:
            assert len(shape["vertices"]) > 11 if shape["type"] == "mesh" else min(shape["size"]) > 0


def test_fingers_objects_and_seats_follow_the_scene(cell):
    bodies = SceneBodies(cell)
    arm, thing, seat = cell.arms[0], cell.objects[0].name, cell.seats[0].name
    moved, aside = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0], [0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0]
    scene = SceneView(poses={thing: moved}, seats={seat: aside}, fingers={arm.name: [0.01, 0.03]})
    poses = dict(zip((row.name for row in bodies.rows), np.array(bodies.poses(scene)).reshape(-1, 7), strict=True))
    assert poses[thing].tolist() == moved
    assert poses[seat].tolist() == aside
    a, b = (poses[f"{arm.name}/{link}"] for link in arm.gripper.finger_links)
    assert geometry.distance(a, b) == pytest.approx(0.04)


def test_a_prediction_has_poses_of_what_it_changes_only(cell):
    bodies = SceneBodies(cell)
    arm = cell.arms[0].name
    poses = np.array(bodies.poses(SceneView(), only={arm})).reshape(-1, 7)
    known = {row.owner for row, pose in zip(bodies.rows, poses, strict=True) if not np.isnan(pose).any()}
    assert known == {arm}


def test_a_frame_has_its_sets_one_after_another():
    frame = pack(7, 1.5, 2.5, [1.0] * 7, [2.0] * 7, true=True)
    assert HEADER.unpack_from(frame) == (7, TRUE, 1.5, 2.5)
    assert struct.unpack_from("<14f", frame, HEADER.size) == (1.0,) * 7 + (2.0,) * 7
    assert len(frame) == HEADER.size + 4 * 14
