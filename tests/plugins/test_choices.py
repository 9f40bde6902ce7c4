"""Evaluators, trimmers and sensors of installed packages."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from rtc.model.cells.cell import Cell
from rtc.plugins import registry
from rtc.protocol.outcomes import StopReason
from rtc.sensing.detector import TagDetector
from rtc.subsystems.perception.camera_thread import CameraThread, Photograph, _Order
from tests.plugins.toy_packages import Install
from tests.workers.conftest import bench  # noqa: F401
from workers.analyzer import analyze

PREFERS = "def score(option):\n    return float(option.candidate.point.name != {!r})\n"


@pytest.mark.parametrize("point", ["HANDLE-A", "HANDLE-B"])
def test_an_evaluator_ranks_the_ways_to_do_a_command(install: Install, bench, point: str) -> None:  # noqa: F811
    install(registry.EVALUATORS, "prefers", "score", PREFERS.format(point))
    assert bench.elaborate("GRASP MACS-NEW WITH RIGHT-ARM").context.grasp_point == point


@pytest.mark.parametrize(("chosen", "expected"), [(5, 5), (9, 4), (None, 4)])
def test_a_trimmer_chooses_among_the_trims_of_the_step(install: Install, chosen: int | None, expected: int) -> None:
    """Trim 3 has been used and trim 9 is not of this step."""
    install(registry.TRIMMERS, "picks", "choose", f"def choose(data, entries):\n    return {chosen}\n")
    task = SimpleNamespace(
        data=SimpleNamespace(trims_used=[3]), context=SimpleNamespace(fits={}), step=SimpleNamespace(trims=[3, 4, 5])
    )
    assert analyze._trim(task, StopReason.TIMEOUT) == expected


FINDS = """
import numpy as np
from rtc.sensing.detector import Mark
def find(camera, image):
    return [Mark(17, np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0]]))] if camera == "CAMERA-1" else []
"""


@pytest.mark.parametrize(("camera", "marks"), [("CAMERA-1", [17]), ("CAMERA-3", [])])
def test_a_sensor_adds_marks_to_a_picture(install: Install, cell: Cell, camera: str, marks: list[int]) -> None:
    install(registry.SENSORS, "toy", "find", FINDS)
    grey = np.full((48, 64, 3), 128, dtype=np.uint8)
    cameras = SimpleNamespace(photograph=lambda *_: Photograph(1.0, [grey], None), release=lambda: None)
    thread = CameraThread(cell, lambda: cameras)
    found = thread._evaluated(_Order(camera, {}), cameras, TagDetector())
    assert [mark.tag for mark in found.marks] == marks
