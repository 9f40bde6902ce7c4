"""The optics and the sensor of a simulated camera: pybullet's matrices, exposure and noise. It does not render."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pybullet
from numpy.typing import NDArray

from rtc.model.cells.parts import Camera
from rtc.sensing.optics import Window
from rtc.spatial import geometry

NEAR_M, FAR_M = 0.05, 12.0
SHIFT_PX = (0.5, -0.5)  # of pybullet's software renderer against an ideal camera: right, down
OPENGL = geometry.from_rpy((0.0, 0.0, 0.0), (math.pi, 0.0, 0.0))  # OpenGL's camera has y up and z backwards


class Matrices(NamedTuple):
    """Column-major 4 x 4 matrices of pybullet."""

    view: Sequence[float]
    lens: Sequence[float]


def matrices(camera: Camera, pose: geometry.Floats, window: Window | None = None) -> Matrices:
    """`pose`: of the camera's axes (x right, y down, z forward), world frame. `window`: only this part of its picture,
    with the same pixels."""
    view = geometry.to_matrix(geometry.inverse(geometry.compose(pose, OPENGL)))
    width, height = camera.size_px
    part = window or Window(0, 0, width, height)
    per_px = 2.0 * NEAR_M * math.tan(math.radians(0.5 * camera.field_of_view_deg)) / height
    left = (part.x - 0.5 * width + SHIFT_PX[0]) * per_px
    top = (0.5 * height - part.y - SHIFT_PX[1]) * per_px
    lens = pybullet.computeProjectionMatrix(
        left, left + part.width * per_px, top - part.height * per_px, top, NEAR_M, FAR_M
    )
    return Matrices(view.T.reshape(-1).tolist(), lens)


def exposed(image: NDArray[np.uint8], camera: Camera, random: np.random.Generator) -> NDArray[np.uint8]:
    """The image as the camera's sensor gives it. Height x width x 3."""
    if camera.noise == 0.0 and camera.exposure == 1.0:
        return image
    noise = random.standard_normal((*image.shape[:2], 1), dtype=np.float32)  # the same in all colours: faster
    if camera.exposure == 1.0:
        shades = image + np.rint(np.float32(camera.noise) * noise).astype(np.int16)
        return np.clip(shades, 0, 255).astype(np.uint8)
    light = np.float32(camera.exposure) * image + np.float32(camera.noise) * noise
    return np.clip(np.rint(light), 0, 255).astype(np.uint8)
