"""What a hand feels through the thing it carries, where that sits in a seat: the seat's bottom, and its catch.

The exact counterpart of `detents`. A thing within `CATCHES_M` of its seated place is caught when it rests there; pulled
out along the seat's way, it pulls with the seat's `detent_n` for `BREAKS_M`. Pressed in beyond its place, it meets the
bottom. The walls to the sides are left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from rtc import cell as cells
from rtc import geometry
from rtc.geometry import Array

BREAKS_M = CATCHES_M = 0.004
BOTTOM_M = 0.001  # play behind a thing that sits in its seat
NEAR_RAD = 0.05
PULLED_M = 1e-5  # less is no pull


class Felt(NamedTuple):
    force: Array  # on the thing, world, N, of the catch; of the bottom its direction alone
    depth_m: float  # into the bottom; 0 = it is free to move


class Seats:
    def __init__(self, cell: cells.Cell, poses: dict[str, Array]) -> None:
        self._poses = poses  # of all objects and seats, world; changed by their owner
        self._seats = [seat for seat in cell.seats if seat.detent_n > 0.0]
        self._inside = {seat.name: seat.module_frame.pose for seat in self._seats}
        self._caught: dict[str, Array] = {}  # thing -> the point where it was caught

    def away_m(self, pose: Array) -> float:
        """How far a thing at this pose may move before any seat matters to it."""
        places = [self._place(seat) for seat in self._seats]
        return min((geometry.distance(pose, place) for place in places), default=math.inf) - 2 * CATCHES_M

    def feel(self, thing: str, pose: Array, still: bool) -> Iterator[Felt]:
        """What acts on the thing at this pose; `still`: it rests there, and is caught."""
        at = self._caught.get(thing)
        if at is not None and math.dist(pose[:3], at) > BREAKS_M:
            del self._caught[thing]
        for seat in self._seats:
            place = self._place(seat)
            if geometry.distance(pose, place) > 2 * CATCHES_M or geometry.angle(pose, place) > NEAR_RAD:
                continue
            out = geometry.rotate(self._poses[seat.name], seat.way_out)
            off = pose[:3] - place[:3]
            along = float(off @ out)
            if float(np.linalg.norm(off - along * out)) > CATCHES_M:
                continue
            if along < -BOTTOM_M:
                yield Felt(out, -BOTTOM_M - along)
            if still and geometry.distance(pose, place) < CATCHES_M:
                self._caught.setdefault(thing, pose[:3].copy())
            at = self._caught.get(thing)
            if at is not None and float((pose[:3] - at) @ out) > PULLED_M:
                yield Felt(-seat.detent_n * out, 0.0)

    def _place(self, seat: cells.Seat) -> Array:
        return geometry.compose(self._poses[seat.name], self._inside[seat.name])
