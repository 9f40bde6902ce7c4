"""Why a camera does not see a body. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from rtc.sensing import optics
from rtc.sensing.locate import TagOnBody, corners
from rtc.sensing.optics import CameraView
from rtc.sensing.pose_fit import area_px
from rtc.spatial import geometry

DARK, BRIGHT = 40, 230  # if nearly all pixels are below or above, no tag has any contrast; white is 255
NEARLY_ALL = 99.0  # percent
MIN_PX = 16.0  # across a tag's black square: two pixels per cell; smaller ones are not read reliably


class Cause(StrEnum):
    NO_TAGS = "it has no tags"
    TOO_DARK = "the picture is too dark"
    TOO_BRIGHT = "the picture is too bright"
    OUT_OF_VIEW = "out of view"
    TOO_SMALL = "its tags are too small in the picture, by distance or tilt"
    OCCLUDED = "something hides it, or it is not where it is believed"


def cause(tags: Sequence[TagOnBody], believed: geometry.Floats, view: CameraView, image: NDArray[np.uint8]) -> Cause:
    """Why none of these tags, all of one body, were found. `believed`: pose of the body, world frame."""
    if not tags:
        return Cause.NO_TAGS
    if np.percentile(image, NEARLY_ALL) < DARK:
        return Cause.TOO_DARK
    if np.percentile(image, 100.0 - NEARLY_ALL) > BRIGHT:
        return Cause.TOO_BRIGHT
    widths = [width for tag in tags if (width := across_px(tag, believed, view)) is not None]
    if not widths:
        return Cause.OUT_OF_VIEW
    return Cause.TOO_SMALL if max(widths) < MIN_PX else Cause.OCCLUDED


def across_px(tag: TagOnBody, believed: geometry.Floats, view: CameraView) -> float | None:
    """The least width of a tag in the picture; None if it is not in it, or turned away."""
    return next(iter(widths_px([tag], believed, [view])[0]), None)


def widths_px(tags: Sequence[TagOnBody], believed: geometry.Floats, views: Sequence[CameraView]) -> list[list[float]]:
    """For each view the least widths of those of these tags, all of one body, that are in its picture."""
    matrix = geometry.to_matrix(believed)
    world = np.array([corners(tag) for tag in tags]) @ matrix[:3, :3].T + matrix[:3, 3]
    normals = np.cross(world[:, 1] - world[:, 0], world[:, 3] - world[:, 0])
    return [[_width_px(view.pixels(world[n])) for n in optics.visible_of(view, world, normals)] for view in views]


def _width_px(pixels: geometry.Array) -> float:
    longest = float(np.linalg.norm(pixels - np.roll(pixels, -1, axis=0), axis=1).max())
    return area_px(pixels) / longest
