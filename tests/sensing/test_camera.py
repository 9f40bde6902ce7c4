"""Cameras of the cell on rendered pictures: what they locate, against the truth of the scene."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from benchmarks import camera as bench
from rtc.drawing.scene import SceneView
from rtc.model.cells.cell import Cell
from rtc.sensing import locate, optics
from rtc.sensing.detector import TagDetector
from rtc.spatial import geometry
from sim_mcm.cameras import render


@pytest.mark.physics
def test_four_tags_are_within_the_budget() -> None:
    """Four tags of 48 mm at 0.6 to 1.2 m, up to 50 degrees, 640 x 480 pixels: median 1 mm and 0.4 degrees."""
    trials = bench.trials(bench.random_poses(40, seed=3), tags=4)
    assert sum(trial.found for trial in trials) >= 39
    found = [trial for trial in trials if trial.found]
    assert np.median([trial.off_mm for trial in found]) <= 1.0
    assert np.median([trial.off_deg for trial in found]) <= 0.4


@pytest.mark.physics
def test_the_cameras_of_the_cell_see_a_module_that_has_moved() -> None:
    cell = Cell.load("swapout")
    studio = render.SceneRenderer(cell)
    moved = {
        name: geometry.compose(
            geometry.translate(cell.object_pose(name), by), geometry.from_rpy((0, 0, 0), (0, 0, math.radians(5)))
        )
        for name, by in (("MACS-NEW", (0.0, 0.02, 0.0)), ("MACS-OLD", (-0.02, 0.0, 0.0)))
    }
    rack = geometry.translate(cell.seat("RACK-1").frame.pose, (0.0, 0.02, 0.0))
    scene = SceneView(poses={name: pose.tolist() for name, pose in moved.items()}, seats={"RACK-1": rack.tolist()})
    studio.pose(scene)
    detector = TagDetector()
    pictures = [
        locate.Seen(optics.view(camera), detector.find(studio.camera_picture(camera.name, scene, seed=1)))
        for camera in cell.cameras
    ]
    studio.close()
    found = locate.locate(cell.tags, pictures)
    assert found.keys() == {"MACS-NEW", "MACS-OLD", "BAY-2", "RACK-1", "RACK-2", "SATELLITE"}
    for name, pose in moved.items():
        assert geometry.distance(found[name].pose, pose) < 0.002, name
        assert geometry.angle(found[name].pose, pose) < math.radians(0.5), name
    assert found["RACK-1"].pose[1] == pytest.approx(rack[1], abs=0.008)  # one tag, seen at an angle of 64 degrees


@pytest.mark.physics
def test_a_camera_without_light_sees_nothing() -> None:
    cell = Cell.load("swapout")
    dark = [msgspec.structs.replace(camera, exposure=0.01) for camera in cell.cameras]
    studio = render.SceneRenderer(msgspec.structs.replace(cell, cameras=dark))
    studio.pose(SceneView())
    assert TagDetector().find(studio.camera_picture("CAMERA-1", SceneView(), seed=1)) == []
    studio.close()
