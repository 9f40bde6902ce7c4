"""Forces of a seat on a carried object: bottom, catch and contacts (the kinematic counterpart of `detents`).

An object that rests within `CATCHES_M` of its seated place is caught. Pulled out along the seat's axis, it resists with
the seat's `detent_n` for `BREAKS_M`. Pressed beyond its place, it meets the bottom. Side walls are left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from rtc.model.cells import cell as cells
from rtc.model.cells import parts
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from sim_mcm.arms.contacts import ASIDE_M, Contacts, out_m

BREAKS_M = CATCHES_M = 0.004
BOTTOM_M = 0.001  # play between a seated object and the bottom
NEAR_RAD = 0.05
PULLED_M = 1e-5  # a smaller displacement does not count as a pull
WEDGES_M, WEDGES_RAD = 0.04, 0.2  # a jammed seat wedges a module this near to its place


class Felt(NamedTuple):
    force: Array  # on the object, world; catch: N; bottom: unit direction only
    depth_m: float  # depth in the bottom; 0 means free to move


class Seats:
    def __init__(self, cell: cells.Cell, poses: dict[str, Array]) -> None:
        self._poses = poses  # of all objects and seats, world; updated by KinematicCell
        self._seats = [seat for seat in cell.seats if seat.detent_n > 0.0]
        self._inside = {seat.name: seat.module_frame.pose for seat in self._seats}
        self._caught: dict[str, Array] = {}  # object -> point where it was caught
        self._jammed: list[parts.Seat] = []
        self._wedged: dict[str, tuple[str, Array]] = {}  # object -> jammed seat, point where it was wedged
        self._cell = cell
        self._sockets = [(seat, seat.mating, Contacts(seat.mating)) for seat in self._seats if seat.mating]
        self._plugs = {thing.name: thing.plug for thing in cell.objects if thing.plug is not None}

    def away_m(self, pose: Array) -> float:
        """Distance (m) that an object at this pose can move without an effect of any seat."""
        places = [self._place(seat) for seat in self._seats + self._jammed]
        effect_m = WEDGES_M if self._jammed else 2 * CATCHES_M
        effect_m = max([effect_m, *(mating.depth_m + ASIDE_M for _, mating, _ in self._sockets)])
        return min((geometry.distance(pose, place) for place in places), default=math.inf) - effect_m

    def jam(self, seat: str, jammed: bool) -> None:
        """Wedge modules in a seat from now on, or free them."""
        self._jammed = [other for other in self._jammed if other.name != seat]
        self._wedged = {thing: wedge for thing, wedge in self._wedged.items() if wedge[0] != seat}
        if jammed:
            found = self._cell.seat(seat)
            self._jammed.append(found)
            self._inside[seat] = found.module_frame.pose

    def feel(self, thing: str, pose: Array, still: bool) -> Iterator[Felt]:
        """Forces on the object at this pose; if `still`, it rests there and is caught."""
        if (at := self._wedge(thing, pose)) is not None:
            off = pose[:3] - at
            if (depth_m := float(np.linalg.norm(off))) > PULLED_M:
                yield Felt(-off / depth_m, depth_m)
            return
        for seat, mating, contacts in self._sockets if thing in self._plugs else ():
            out = geometry.rotate(self._poses[seat.name], seat.way_out)
            if mating.connector == self._plugs[thing] and (at_m := out_m(self._place(seat), out, pose)) is not None:
                yield Felt(contacts.push_n(thing, at_m) * out, 0.0)
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

    def _wedge(self, thing: str, pose: Array) -> Array | None:
        """The point where a jammed seat holds the object, or None."""
        for seat in self._jammed if thing not in self._wedged else ():
            place = self._place(seat)
            if geometry.distance(pose, place) < WEDGES_M and geometry.angle(pose, place) < WEDGES_RAD:
                self._wedged[thing] = seat.name, pose[:3].copy()
        return self._wedged[thing][1] if thing in self._wedged else None

    def _place(self, seat: parts.Seat) -> Array:
        return geometry.compose(self._poses[seat.name], self._inside[seat.name])
