"""Which cameras can see a body at a pose. Pure.

A camera counts if a tag of the body faces it, lies in its picture and is large enough to be read. Bodies that hide the
tag are not considered: a look finds them out.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Camera, Tag
from rtc.sensing import absence, optics
from rtc.spatial.geometry import Array, Floats

MAX_PICTURES = 10_000  # maximum number of kept pictures of one cell


def tags(cell: Cell, body: str) -> list[Tag]:
    return [tag for tag in cell.tags if tag.body == body]


def bodies(cell: Cell) -> list[str]:
    """Objects and seats with tags, in the order of the cell."""
    return list(dict.fromkeys(tag.body for tag in cell.tags))


class Sight:
    """The cameras of one cell. It keeps what it has computed: a body mostly rests, and so do most cameras."""

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self._widest_px: dict[tuple[object, ...], float] = {}  # of the tags of a body in the picture of a camera

    def cameras(self, body: str, pose: Floats, tcp: Callable[[str], Array]) -> list[Camera]:
        """The cameras that can see a body at this pose (world frame), the one with the largest picture of it first.

        `tcp`: pose of an arm's tcp, world frame, for a camera that the arm carries."""
        known, every = tags(self._cell, body), self._cell.cameras
        if not known:
            return []
        hands = [tcp(camera.arm) if camera.arm else None for camera in every]
        place = np.asarray(pose, dtype=float).tobytes()
        keys = [
            (camera.name, body, place, None if hand is None else hand.tobytes())
            for camera, hand in zip(every, hands, strict=True)
        ]
        kept = self._widest_px
        new = [n for n, key in enumerate(keys) if key not in kept]
        if len(kept) > MAX_PICTURES:
            kept.clear()
            new = list(range(len(keys)))
        if new:
            views = [optics.view(every[n], hands[n]) for n in new]
            for n, widths in zip(new, absence.widths_px(known, pose, views), strict=True):
                kept[keys[n]] = max(widths, default=0.0)
        able = [(kept[key], camera) for key, camera in zip(keys, every, strict=True) if kept[key] >= absence.MIN_PX]
        return [camera for _, camera in sorted(able, key=lambda one: -one[0])]
