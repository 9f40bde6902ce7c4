"""Where the bodies of the cell are, from the tags in pictures of one or several cameras at one time.

It knows the cell file and pictures, never a true pose.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from rtc.sensing.detector import DetectedTag
from rtc.sensing.optics import CORNERS, CameraView
from rtc.sensing.pose_fit import Fit, TagObservation, fit
from rtc.spatial import geometry
from rtc.spatial.geometry import Array


class HasPose(Protocol):
    @property
    def pose(self) -> Array: ...


class TagOnBody(Protocol):
    """A tag as a cell file or a primitive states it. `frame`: of its centre, in the axes of the body."""

    @property
    def id(self) -> int: ...
    @property
    def body(self) -> str: ...
    @property
    def size_m(self) -> float: ...
    @property
    def frame(self) -> HasPose: ...


class Seen(NamedTuple):
    """The tags in one picture."""

    view: CameraView
    marks: Sequence[DetectedTag]


def corners(tag: TagOnBody) -> Array:
    """Corners of a tag in the axes of its body, 4 x 3, m."""
    matrix = geometry.to_matrix(tag.frame.pose)
    found: Array = 0.5 * tag.size_m * CORNERS @ matrix[:3, :3].T + matrix[:3, 3]
    return found


def sightings(tags: Iterable[TagOnBody], pictures: Iterable[Seen]) -> dict[str, list[TagObservation]]:
    """Sightings by body. Tags that the cell does not know are ignored."""
    known = {tag.id: tag for tag in tags}
    found: dict[str, list[TagObservation]] = {}
    for picture in pictures:
        for mark in picture.marks:
            if (tag := known.get(mark.tag)) is not None:
                sighting = TagObservation(tag.id, picture.view, np.asarray(mark.corners), corners(tag))
                found.setdefault(tag.body, []).append(sighting)
    return found


def locate(
    tags: Iterable[TagOnBody], pictures: Iterable[Seen], near: Mapping[str, geometry.Floats] | None = None
) -> Mapping[str, Fit]:
    """The bodies that are seen, by name. `near`: expected poses of bodies, world frame; they save time."""
    expected = {body: geometry.to_matrix(pose) for body, pose in (near or {}).items()}
    fits = {body: fit(seen, expected.get(body)) for body, seen in sightings(tags, pictures).items()}
    return {body: found for body, found in fits.items() if found is not None}
