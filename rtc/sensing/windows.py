"""The parts of a picture in which the tags of a body are expected: a small part of its pixels. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rtc.sensing import absence
from rtc.sensing.locate import TagOnBody, corners
from rtc.sensing.optics import CameraView, Window
from rtc.spatial import geometry
from rtc.spatial.geometry import Array

MARGIN = 0.18  # around a tag, in its widths: its white border, and what it moves more than was predicted
MIN_MARGIN_PX = 5.0
MAX_SHARE = 0.5  # share of the picture's pixels; above it, the whole picture is as fast


def windows(tags: Sequence[TagOnBody], pose: geometry.Floats, view: CameraView) -> dict[int, Window]:
    """By the number of the tag. Empty if the whole picture is better. `pose`: of the body, world frame."""
    found = {
        tag.id: _around(_pixels(tag, pose, view), view)
        for tag in tags
        if (absence.across_px(tag, pose, view) or 0.0) >= absence.MIN_PX
    }
    pixels = sum(window.width * window.height for window in found.values())
    return found if pixels <= MAX_SHARE * math.prod(view.size_px) else {}


def _pixels(tag: TagOnBody, pose: geometry.Floats, view: CameraView) -> Array:
    matrix = geometry.to_matrix(pose)
    return view.pixels(corners(tag) @ matrix[:3, :3].T + matrix[:3, 3])


def _around(pixels: Array, view: CameraView) -> Window:
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    margin = max(MIN_MARGIN_PX, MARGIN * float((high - low).max()))
    left, top = (max(0, n) for n in np.floor(low - margin).astype(int).tolist())
    right, bottom = (
        min(n, end) for n, end in zip(np.ceil(high + margin).astype(int).tolist(), view.size_px, strict=True)
    )
    return Window(left, top, right - left, bottom - top)
