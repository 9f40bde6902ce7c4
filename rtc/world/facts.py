"""The typed reading of the world's facts about one cell: arms, hands, objects, hinges and seats. Pure.

A value is read whether its fact is trusted or not. What has no fact is as the cell description has it. Poses are
[x y z qx qy qz qw] in m, in the world frame unless stated; joints and angles are in rad.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from rtc.model.cells import parts, taught
from rtc.model.cells.cell import Cell
from rtc.protocol.messages import Validity
from rtc.spatial import geometry, hinges
from rtc.spatial.geometry import Array, Floats
from rtc.world.model import LOOSE, TIGHT, World
from rtc.world.spread import EXACT, Spread

BESIDE_M = 0.04  # maximum distance from the axis of a seat's way out at which an object is in its slot
TRUSTED = (Validity.VALID, Validity.CHANGING)


class Facts:
    """One view of the world of one cell; neither may change."""

    def __init__(self, cell: Cell, world: World) -> None:
        self.cell = cell
        self.world = world

    @cached_property
    def taught_places(self) -> list[parts.Place]:
        """Those that the cell does not have: see `rtc.model.cells.taught`."""
        facts = self.world.facts
        known = taught.postures((key, facts[key].value) for key in facts if taught.POSTURE in key)
        return taught.as_places(self.cell, known) if known else []

    @property
    def places(self) -> list[parts.Place]:
        """The places of the cell, and the taught ones."""
        return [*self.cell.places, *self.taught_places]

    def joints(self, arm: str) -> list[float]:
        """Joint values as last reported; the home position before any report."""
        return self.world.value(f"{arm}.joints") or self.cell.arm(arm).home_rad

    def hand_width(self, arm: str) -> float:
        width = self.world.value(f"{arm}.hand_width")
        return self.cell.arm(arm).gripper.max_opening_m if width is None else float(width)

    def hand_force(self, arm: str) -> float:
        """The force (N) with which the hand gripped when it had closed; 0: it does not grip, or has not closed yet."""
        return float(self.world.value(f"{arm}.hand_force") or 0.0)

    def hand(self, arm: str) -> str:
        """The hand in the coupler of an arm; empty: none, or it has no coupler."""
        return self.world.value(f"{arm}.hand") or ""

    def holding(self, arm: str) -> str:
        return self.world.value(f"{arm}.holding") or ""

    def sharers(self, arm: str) -> list[str]:
        """The other arms that hold the object that this arm holds."""
        held = self.holding(arm)
        return [a.name for a in self.cell.arms if held and a.name != arm and self.holding(a.name) == held]

    def held_by(self, thing: str) -> str:
        return self.world.value(f"{thing}.held_by") or ""

    def seat(self, thing: str) -> str:
        return self.world.value(f"{thing}.seat") or ""

    def leaves_along(self, thing: str) -> Array:
        """Unit vector (world) along which an object leaves the seat that it is in or partly in; up without a seat.

        A seat holds its object up to a small play, so the better known attitude of the two is that of both."""
        seat = self.seat(thing) or self.seat_around(thing)
        if not seat:
            return np.array((0.0, 0.0, 1.0))
        inside = geometry.compose(self.frame(thing), geometry.inverse(self.cell.seat(seat).module_frame.pose))
        known = [(self.spread(f"{seat}.frame"), self.seat_frame(seat)), (self.spread(f"{thing}.frame"), inside)]
        _, attitude = min(known, key=lambda one: max(one[0][3:]))
        return geometry.rotate(attitude, self.cell.seat(seat).way_out)

    def seat_around(self, thing: str) -> str:
        """The seat in whose slot an object is, although it need not be seated; empty if there is none.

        This is the case when a motion into or out of the seat was stopped.
        """
        return self.slot_at(self.frame(thing))

    def slot_at(self, frame: Floats) -> str:
        """The seat in whose slot an object with this frame is; empty if there is none."""
        for seat in self.cell.seats:
            out = self.out_of(seat.name)
            off = np.asarray(frame[:3]) - self.seated_pose(seat.name)[:3]
            along = float(off @ out)
            if -BESIDE_M < along < seat.depth_m and float(np.linalg.norm(off - along * out)) < BESIDE_M:
                return seat.name
        return ""

    def inside(self, seat: str) -> list[str]:
        """The objects in this seat."""
        return [thing.name for thing in self.cell.objects if seat and self.seat(thing.name) == seat]

    def seat_frame(self, seat: str) -> Array:
        """The seat's frame: the fact if there is one, else the pose in the cell description."""
        frame = self.world.value(f"{seat}.frame")
        return self.cell.seat(seat).frame.pose if frame is None else geometry.normalise(frame)

    def seated_pose(self, seat: str) -> Array:
        """The frame of an object seated in this seat."""
        return geometry.compose(self.seat_frame(seat), self.cell.seat(seat).module_frame.pose)

    def out_of(self, seat: str) -> Array:
        """Unit vector (world) along which an object leaves this seat."""
        return geometry.rotate(self.seat_frame(seat), self.cell.seat(seat).way_out)

    def out_m(self, seat: str, frame: Floats) -> float:
        """How far an object at this frame (world) is out of the seat, along its way out (m)."""
        return float((np.asarray(frame[:3]) - self.seated_pose(seat)[:3]) @ self.out_of(seat))

    def frame(self, thing: str) -> Array:
        """The object's frame, trusted or not: the fact if there is one, else the pose in the cell description."""
        frame = self.world.value(f"{thing}.frame")
        return self.cell.object_pose(thing) if frame is None else geometry.normalise(frame)

    def pose(self, body: str) -> Array:
        """The frame of an object or seat, trusted or not."""
        return self.seat_frame(body) if self.is_seat(body) else self.frame(body)

    def is_seat(self, body: str) -> bool:
        return any(seat.name == body for seat in self.cell.seats)

    def hinge(self, thing: str) -> parts.Hinge | None:
        """The hinge of an object; None if it has none, or is not an object."""
        return next((one.hinge for one in self.cell.objects if one.name == thing), None)

    def angle(self, thing: str) -> float:
        """The angle of an object with a hinge (rad)."""
        angle = self.world.value(f"{thing}.angle")
        hinge = self.hinge(thing)
        return float(angle) if angle is not None else math.radians(hinge.at_deg) if hinge else 0.0

    def hinge_home(self, thing: str) -> Array:
        """The frame of an object with a hinge when its angle is 0."""
        hinge = self.hinge(thing)
        assert hinge is not None, thing
        return hinges.turned(self.frame(thing), hinge.axis, -self.angle(thing))

    @cached_property
    def displaced(self) -> set[str]:
        """The fixed objects that are elsewhere than in the cell description. A bolt is fixed but for its thread."""
        fixed = [thing.name for thing in self.cell.objects if thing.fixed and thing.thread is None]
        values = {name: self.world.value(f"{name}.frame") for name in fixed}
        return {n for n, at in values.items() if at is not None and at != self.cell.object_pose(n).tolist()}

    @cached_property
    def bodies(self) -> dict[str, str]:
        """By seat or object: the body that it is mounted on."""
        every: list[parts.Seat | parts.Object] = [*self.cell.seats, *self.cell.objects]
        return {part.name: part.mounted_on for part in every if part.mounted_on is not None}

    def mount(self, part: parts.Seat | parts.Object) -> Array:
        """Where the body that a part is mounted on carries it, wherever that body is believed to be: the frame of the
        part, of one with a hinge at angle 0, of a bolt tight. Of what is mounted on nothing: as in the cell."""
        if part.mounted_on is None or part.mounted_on not in self.displaced:
            return part.frame.pose
        on_body = geometry.relative(self.cell.object_pose(part.mounted_on), part.frame.pose)
        return geometry.compose(self.frame(part.mounted_on), on_body)

    def thread(self, thing: str) -> parts.Thread | None:
        """The thread of a bolt; None if it has none, or is not an object."""
        return next((one.thread for one in self.cell.objects if one.name == thing), None)

    def driver(self, arm: str) -> parts.Object | None:
        """The object with a spindle that this arm holds; None without one."""
        held = self.holding(arm)
        return next((one for one in self.cell.objects if one.name == held and one.spindle is not None), None)

    def turns(self, thing: str) -> float:
        """By how many turns a bolt is out of its tight place."""
        return float(self.world.value(f"{thing}.turns") or 0.0)

    def turned_out(self, thing: str, turns: float) -> Array:
        """The frame of a bolt that is out by this many turns. Its fact `frame` is that at `turns`."""
        thread = self.thread(thing)
        assert thread is not None, thing
        out_m = thread.pitch_m * (turns - self.turns(thing))
        return geometry.compose(self.frame(thing), (0.0, 0.0, out_m, 0.0, 0.0, 0.0, 1.0))

    def fastening(self, seat: str) -> list[str]:
        """The bolts of a seat that are not loose, as far as is known: they fasten what is in it."""
        return [bolt for bolt in self.cell.seat(seat).bolts if self.world.value(f"{bolt}.state", TIGHT) != LOOSE]

    def hung(self, thing: str, point: Floats, where: Floats) -> Array:
        """The frame of an object with a hinge when a point of it (m, its axes) is nearest to `where` (m, world)."""
        hinge, home = self.hinge(thing), self.hinge_home(thing)
        assert hinge is not None, thing
        return hinges.at_hand(home, hinge.axis, hinge.range_rad, point, where)

    def in_hand(self, thing: str, tcp: Floats) -> Array | None:
        """The frame of a held object when its hand is at `tcp`; None if it is not held."""
        grasp = self.grasp(thing)
        if grasp is None:
            return None
        if (hinge := self.hinge(thing)) is not None:
            home, bar = (self.frame(thing), self.angle(thing)), self._bar(thing, grasp)
            return hinges.in_hand(*home, hinge.axis, hinge.range_rad, grasp, tcp, bar)
        return geometry.compose(tcp, grasp)

    def _bar(self, thing: str, grasp: Floats) -> Array:
        return hinges.bar((point.frame.xyz for point in self.cell.object(thing).grasp_points), grasp)

    def hinge_of_tcp(self, arm: str, tcp: Floats, about: Floats, hand_turn: float) -> Array:
        """The hinge about which the tcp turns, if the hand turns the object that it holds about the hinge `about`.

        They differ if the bar is not at the tcp and the hand keeps its attitude (`hand_turn` 0; 1: as if fixed to the
        object). Then the centre of the tcp is as far from the hinge as the tcp is from the bar. All poses: world.
        """
        thing = self.holding(arm)
        grasp = self.grasp(thing) if self.hinge(thing) is not None else None
        if grasp is None:
            return np.asarray(about, dtype=float)
        bar = geometry.transform_point(tcp, geometry.transform_point(grasp, self._bar(thing, grasp)))
        return geometry.translate(about, (1.0 - hand_turn) * (np.asarray(tcp[:3], dtype=float) - bar))

    def grasp_after(self, thing: str, frame: Floats, tcp: Floats) -> list[float] | None:
        """The grasp of an object that has turned in the hand about its hinge; None: the grasp is the same as before."""
        return None if self.hinge(thing) is None else geometry.normalise(geometry.relative(tcp, frame)).tolist()

    def grasp(self, thing: str) -> Array | None:
        """The held object's frame in the tcp frame; None if it is not held."""
        grasp = self.world.value(f"{thing}.grasp")
        return None if grasp is None else geometry.normalise(grasp)

    def point_in_hand(self, thing: str) -> parts.GraspPoint | None:
        """The grasp point nearest to the tcp according to the grasp; None without a grasp."""
        grasp = self.grasp(thing)
        if grasp is None:
            return None
        points = self.cell.object(thing).grasp_points
        return min(points, key=lambda p: math.hypot(*geometry.compose(grasp, p.frame.pose)[:3]), default=None)

    def off_hand_m(self, thing: str, frame: Floats, tcp: Floats) -> float:
        """Distance (m) of the nearest grasp point of an object at this frame from the tcp (world); inf without one."""
        points = (geometry.compose(frame, point.frame.pose) for point in self.cell.object(thing).grasp_points)
        return min((geometry.distance(tcp, point) for point in points), default=math.inf)

    def spread(self, key: str) -> Spread:
        """Uncertainty of the pose of this fact; EXACT if the fact has none."""
        fact = self.world.get(key)
        return EXACT if fact is None or fact.spread is None else fact.spread

    def trusts(self, key: str) -> bool:
        """Whether this fact is trusted."""
        fact = self.world.get(key)
        return fact is None or fact.validity in TRUSTED
