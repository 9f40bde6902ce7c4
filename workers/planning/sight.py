"""Which cameras can see a body at a pose. Pure.

A camera counts if a tag of the body faces it, lies in its picture and is large enough to be read. Bodies that hide the
tag are not considered: a look finds them out.
"""

from __future__ import annotations

from collections.abc import Callable

from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Camera, Tag
from rtc.sensing import absence, optics
from rtc.spatial.geometry import Array, Floats


def tags(cell: Cell, body: str) -> list[Tag]:
    return [tag for tag in cell.tags if tag.body == body]


def bodies(cell: Cell) -> list[str]:
    """Objects and seats with tags, in the order of the cell."""
    return list(dict.fromkeys(tag.body for tag in cell.tags))


def cameras(cell: Cell, body: str, pose: Floats, tcp: Callable[[str], Array]) -> list[Camera]:
    """The cameras that can see a body at this pose (world frame), the one with the largest picture of it first.

    `tcp`: pose of an arm's tcp, world frame, for a camera that the arm carries."""
    known = tags(cell, body)
    if not known:
        return []
    views = [optics.view(camera, tcp(camera.arm) if camera.arm else None) for camera in cell.cameras]
    widest = [max(widths, default=0.0) for widths in absence.widths_px(known, pose, views)]
    able = [(width, camera) for width, camera in zip(widest, cell.cameras, strict=True) if width >= absence.MIN_PX]
    return [camera for _, camera in sorted(able, key=lambda one: -one[0])]
