"""Which cameras can see a body at a pose. Pure.

A camera counts if a tag of the body faces it, lies in its picture and is large enough to be read. Bodies that hide the
tag are not considered: a look finds them out.
"""

from __future__ import annotations

from collections.abc import Callable

from rtc.cells.cell import Cell
from rtc.cells.parts import Camera, Tag
from rtc.robot.geometry import Array, Floats
from rtc.sensing import absence, optics


def tags(cell: Cell, body: str) -> list[Tag]:
    return [tag for tag in cell.tags if tag.body == body]


def bodies(cell: Cell) -> list[str]:
    """Objects and seats with tags, in the order of the cell."""
    return list(dict.fromkeys(tag.body for tag in cell.tags))


def cameras(cell: Cell, body: str, pose: Floats, tcp: Callable[[str], Array]) -> list[Camera]:
    """The cameras that can see a body at this pose (world frame), the one with the largest picture of it first.

    `tcp`: pose of an arm's tcp, world frame, for a camera that the arm carries."""
    known = tags(cell, body)
    widths = {camera.name: _across_px(known, pose, camera, tcp) for camera in cell.cameras} if known else {}
    able = [camera for camera in cell.cameras if widths.get(camera.name, 0.0) >= absence.LEAST_PX]
    return sorted(able, key=lambda camera: -widths[camera.name])


def _across_px(known: list[Tag], pose: Floats, camera: Camera, tcp: Callable[[str], Array]) -> float:
    """Width (pixels) of the largest of the tags in the camera's picture; 0 if none is in it."""
    view = optics.view(camera, tcp(camera.arm) if camera.arm else None)
    widths = (absence.across_px(tag, pose, view) for tag in known)
    return max((width for width in widths if width is not None), default=0.0)
