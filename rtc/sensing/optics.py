"""An ideal camera as numbers: where a point of the world appears in its picture. Pure.

Pixels: x to the right, y down, the corner of the picture is (0, 0). Camera axes: x right, y down, z forward.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rtc.model.cells.parts import Camera
from rtc.spatial import geometry
from rtc.spatial.geometry import Array


class Window(NamedTuple):
    """A part of a picture, in pixels: its upper left corner and its size."""

    x: int
    y: int
    width: int
    height: int


class CameraView(NamedTuple):
    """A camera at the time of a picture."""

    camera: str
    rotation: Array  # 3 x 3, world to camera
    translation: Array  # m, world to camera
    focal_px: float
    size_px: tuple[int, int]

    @property
    def centre_px(self) -> tuple[float, float]:
        return 0.5 * self.size_px[0], 0.5 * self.size_px[1]

    def to_camera(self, points: Array) -> Array:
        """Points (... x 3, m) of the world in the axes of the camera."""
        seen: Array = points @ self.rotation.T + self.translation
        return seen

    def pixels(self, points: Array) -> Array:
        """Pixels (... x 2) of points of the world (... x 3, m), which must lie in front of the camera."""
        seen = self.to_camera(points)
        found: Array = self.focal_px * seen[..., :2] / seen[..., 2:] + self.centre_px
        return found


def view(camera: Camera, tcp: geometry.Floats | None = None) -> CameraView:
    """The view of a camera of the cell. `tcp`: world pose, for a camera on an arm."""
    pose = camera.pose if tcp is None else geometry.compose(tcp, camera.pose)
    matrix = geometry.to_matrix(geometry.inverse(pose))
    focal_px = 0.5 * camera.size_px[1] / math.tan(math.radians(0.5 * camera.field_of_view_deg))
    return CameraView(camera.name, matrix[:3, :3], matrix[:3, 3], focal_px, camera.size_px)


#: corners of a tag in its own axes, in halves of its size: lower left, lower right, upper right, upper left
CORNERS = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], dtype=np.float64)


def visible(view: CameraView, corners: Array, normal: Array) -> bool:
    """Whether a tag faces the camera and lies in the picture, if nothing is in front of it. `corners`: 4 x 3, m, and
    `normal`, world frame."""
    return len(visible_of(view, corners[None], normal[None])) > 0


def visible_of(view: CameraView, corners: Array, normals: Array) -> list[int]:
    """The numbers of the tags that are `visible`. `corners`: tags x 4 x 3, m, and `normals`, world frame."""
    seen = view.to_camera(corners)
    facing = (seen.mean(axis=1) * (normals @ view.rotation.T)).sum(axis=1) < 0.0
    found = np.flatnonzero(facing & (seen[:, :, 2] > 0.0).all(axis=1))
    pixels = view.pixels(corners[found])
    within = ((pixels >= 0.0) & (pixels <= view.size_px)).all(axis=(1, 2))
    numbers: list[int] = found[within].tolist()
    return numbers
