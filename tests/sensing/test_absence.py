"""Why a body is not seen: each cause where it holds, and no other."""

from __future__ import annotations

import numpy as np
import pytest

from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Camera
from rtc.sensing import optics
from rtc.sensing.absence import Cause, cause
from rtc.spatial import geometry

GREY = np.linspace(0, 255, 60, dtype=np.uint8).reshape(6, 10)
DARK, BRIGHT = np.full((6, 10), 5, np.uint8), np.full((6, 10), 250, np.uint8)
MODULE = geometry.make_pose((0.8, -0.8, 0.6))


def camera(
    xyz: tuple[float, float, float], looks_at: tuple[float, float, float] = (0.8, -0.8, 0.6)
) -> optics.CameraView:
    return optics.view(Camera(name="CAMERA-9", xyz=xyz, looks_at=looks_at))


NEAR = camera((0.5, -1.3, 1.25))


@pytest.mark.parametrize(
    ("view", "image", "expected"),
    [
        (NEAR, GREY, Cause.OCCLUDED),
        (NEAR, DARK, Cause.TOO_DARK),
        (NEAR, BRIGHT, Cause.TOO_BRIGHT),
        (camera((0.5, -1.3, 1.25), (0.5, -3.0, 1.0)), GREY, Cause.OUT_OF_VIEW),  # it looks elsewhere
        (camera((1.5, -0.8, 0.4)), GREY, Cause.OUT_OF_VIEW),  # behind the module, below its top
        (camera((0.0, -3.0, 4.0)), GREY, Cause.TOO_SMALL),
        (camera((1.5, -1.1, 0.78)), GREY, Cause.TOO_SMALL),  # near, but nearly along its top
    ],
)
def test_a_cause_is_named(view, image, expected) -> None:
    tags = [tag for tag in Cell.load("swapout").tags if tag.body == "MACS-NEW"]
    assert cause(tags, MODULE, view, image) is expected


def test_a_body_without_tags_is_not_seen_by_any_camera() -> None:
    assert cause([], MODULE, NEAR, GREY) is Cause.NO_TAGS
