"""AprilTags in a picture: ids and corners. It knows neither poses nor the cell."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyapriltags import Detector

from rtc.sensing.optics import Window
from rtc.spatial.geometry import Array


class DetectedTag(NamedTuple):
    """A tag in a picture. `corners`: 4 x 2 pixels, in the order of `optics.CORNERS`."""

    tag: int
    corners: Array


class TagDetector:
    """Finds tags of the family 36h11 that are read without a wrong bit, so a pattern by chance is not a tag."""

    def __init__(self) -> None:
        self._detector = Detector(
            families="tag36h11", quad_decimate=1.0
        )  # with fewer pixels corners are 1.4 x as far off

    def find_in(self, parts: Mapping[int, tuple[Window, NDArray[np.uint8]]]) -> list[DetectedTag]:
        """Each tag in a window of the picture, by its number; the corners are pixels of the whole picture."""
        found = []
        for tag, (window, image) in parts.items():
            offset = (window.x, window.y)
            found += [DetectedTag(tag, mark.corners + offset) for mark in self.find(image) if mark.tag == tag]
        return found

    def find(self, image: NDArray[np.uint8]) -> list[DetectedTag]:
        """`image`: height x width x 3, or grey. A tag that appears twice is left out."""
        grey = image if image.ndim == 2 else image[:, :, 1]  # a tag is black and white: one colour has its contrast
        found = [hit for hit in self._detector.detect(np.ascontiguousarray(grey)) if hit.hamming == 0]
        ids = [hit.tag_id for hit in found]
        return [DetectedTag(hit.tag_id, np.array(hit.corners)) for hit in found if ids.count(hit.tag_id) == 1]
