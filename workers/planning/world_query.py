"""Queries on one view of the world for motion planning: joints, hands, frames and collision scenes. Pure.

A fact that is not trusted yields a Refusal that states what would clear it. Joints are used as last reported, even if
they are not valid. A subsystem refuses a trajectory that does not start at the arm's position, and its report then
corrects the fact.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rtc.language.hands import hand_in_words
from rtc.model.cells import cell as cells
from rtc.model.cells import parts, taught
from rtc.model.robot.collision_scene import AttachedBody, Held, Scene
from rtc.protocol.messages import Limits, Validity
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.primitive import Load, Primitive
from rtc.spatial import geometry, hinges
from rtc.spatial.geometry import Array, Floats
from rtc.world.model import World
from rtc.world.spread import EXACT, Spread
from workers.planning import axes, pose_spread, sight
from workers.planning.motion.constraints import PathConstraints
from workers.planning.motion.request import PlanningRequest
from workers.planning.motion.timing import SpeedLimits
from workers.planning.robot_models import CellModel

UNKNOWN_RADIUS_M = 0.1  # an object of unknown inertia is modelled as a solid ball of this radius
# Least distance of arms and held objects from all that a command does not mean to touch. The hand tracks a path to
# tenths of a millimetre.
CLEARANCE_M = 0.005
ARMS_APART_M = 0.005  # least distance of a planned path from another arm
BESIDE_M = 0.04  # maximum distance from the axis of a seat's way out at which an object is in its slot
UNSURE_STEP_M = 0.001  # spreads are rounded up to a multiple of this: a way stays valid while a grasp creeps a little
AHEAD_S = 15.0  # the creep of a held object during this time counts: a carry across the default cell takes 9 s
TRUSTED = (Validity.VALID, Validity.CHANGING)


@dataclass(frozen=True)
class WorldQuery:
    """Queries on one world view of one cell. Poses are [x y z qx qy qz qw] in m, in the world frame unless stated.

    `at_s`: when the query is made (the clock of `Fact.at_s`); 0: unknown, so that no fact has an age.
    `seed`: of the sampling planner in this job. `moving`: the primitives that other arms execute now.
    """

    model: CellModel
    world: World
    at_s: float = 0.0
    seed: int = 0
    moving: Sequence[Primitive] = ()

    @property
    def cell(self) -> cells.Cell:
        return self.model.cell

    @property
    def taught_places(self) -> list[parts.Place]:
        """Those that the cell does not have: see `rtc.model.cells.taught`."""
        values = ((key, fact.value) for key, fact in self.world.facts.items())
        return taught.as_places(self.cell, taught.postures(values))

    @property
    def places(self) -> list[parts.Place]:
        """The places of the cell, and the taught ones."""
        return [*self.cell.places, *self.taught_places]

    # --- facts ---------------------------------------------------------------------------------------------

    def joints(self, arm: str) -> list[float]:
        """Joint values as last reported (rad); the home position before any report. Of a moving arm: at its goal."""
        for primitive in self.moving:
            if (path := primitive.paths.get(arm)) is not None:
                return path.positions[-1]
        return self.world.value(f"{arm}.joints") or self.cell.arm(arm).home_rad

    def tcp(self, arm: str) -> Array:
        return self.model.arms[arm].fk(self.joints(arm))

    def hand_width(self, arm: str) -> float:
        width = self.world.value(f"{arm}.hand_width")
        return self.cell.arm(arm).gripper.max_opening_m if width is None else float(width)

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

    def way_out(self, thing: str) -> str:
        """Name of the direction in which an object leaves the seat that it is in or partly in; UP without a seat."""
        seat = self.seat(thing) or self.seat_around(thing)
        return self.way_out_of(seat) if seat else "UP"

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

    def way_out_of(self, seat: str) -> str:
        """Name of the direction in which an object leaves this seat."""
        return axes.name_of(geometry.rotate(self.seat_frame(seat), self.cell.seat(seat).way_out).tolist())

    def seat_around(self, thing: str) -> str:
        """The seat in whose slot an object is, although it need not be seated; empty if there is none.

        This is the case when a motion into or out of the seat was stopped.
        """
        return self.slot_at(self.frame(thing))

    def slot_at(self, frame: Floats) -> str:
        """The seat in whose slot an object with this frame is; empty if there is none."""
        for seat in self.cell.seats:
            out = geometry.rotate(self.seat_frame(seat.name), seat.way_out)
            off = np.asarray(frame[:3]) - self.seated_pose(seat.name)[:3]
            along = float(off @ out)
            if -BESIDE_M < along < seat.depth_m and float(np.linalg.norm(off - along * out)) < BESIDE_M:
                return seat.name
        return ""

    def seat_frame(self, seat: str) -> Array:
        """The seat's frame: the fact if there is one, else the pose in the cell description."""
        frame = self.world.value(f"{seat}.frame")
        return self.cell.seat(seat).frame.pose if frame is None else geometry.normalise(frame)

    def seated_pose(self, seat: str) -> Array:
        """The frame of an object seated in this seat."""
        return geometry.compose(self.seat_frame(seat), self.cell.seat(seat).module_frame.pose)

    def frame(self, thing: str) -> Array:
        """The object's frame, trusted or not: the fact if there is one, else the pose in the cell description."""
        frame = self.world.value(f"{thing}.frame")
        return self.cell.object_pose(thing) if frame is None else geometry.normalise(frame)

    def pose(self, body: str) -> Array:
        """The frame of an object or seat, trusted or not."""
        return self.seat_frame(body) if any(seat.name == body for seat in self.cell.seats) else self.frame(body)

    def cameras(self, body: str) -> list[parts.Camera]:
        """The cameras that can see an object or seat where it is believed to be, the best one first."""
        if body not in self._cameras:
            self._cameras[body] = sight.cameras(self.cell, body, self.pose(body), self.tcp)
        return self._cameras[body]

    @cached_property
    def _cameras(self) -> dict[str, list[parts.Camera]]:
        """Those of the bodies that were asked for: the world of a query does not change."""
        return {}

    def finds(self, body: str) -> bool:
        """Whether a camera can see the body where it is believed to be, and the last look has not missed it."""
        fact = self.world.get(f"{body}.sighting")
        return (fact is None or fact.value is not None) and bool(self.cameras(body))

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

    def spread(self, key: str) -> Spread:
        """Uncertainty of the pose of this fact; EXACT if the fact has none."""
        fact = self.world.get(key)
        return EXACT if fact is None or fact.spread is None else fact.spread

    def grasp_spread(self, thing: str, ahead_s: float = 0.0) -> Spread:
        """Uncertainty of a held object's pose `ahead_s` after the query; it grows with time in the hand."""
        key = f"{thing}.grasp"
        fact = self.world.get(key)
        age_s = max(0.0, self.at_s - fact.at_s) if fact is not None else 0.0
        return pose_spread.crept_spread(self.spread(key), age_s + ahead_s, self.cell.numbers)

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

    def load(self, arm: str) -> Load | None:
        """Mass, centre of mass and inertia of the held object in the tcp frame; None if its hinge carries it."""
        thing = self.holding(arm)
        if self.hinge(thing) is not None:
            return None
        grasp = self.grasp(thing) if thing else None
        if grasp is None:
            return None
        if (holder := self.held_by(thing)) not in ("", arm):  # both hold it; the grasp is that of the other hand
            grasp = geometry.relative(self.tcp(arm), geometry.compose(self.tcp(holder), grasp))
        known = self.cell.object(thing)
        mass_kg = float(self.world.value(f"{thing}.mass") or known.mass_kg)
        turn = geometry.to_matrix(grasp)[:3, :3]
        own = np.diag(known.inertia_kg_m2 or [0.4 * mass_kg * UNKNOWN_RADIUS_M**2] * 3)
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = (turn @ own @ turn.T).tolist()
        return Load(mass_kg=mass_kg, com_m=grasp[:3].tolist(), inertia_kg_m2=[xx, yy, zz, xy, xz, yz])

    def trusts(self, key: str) -> bool:
        """Whether this fact is trusted."""
        return self.distrusted(key, {}) is None

    def distrusted(self, key: str, clears: Mapping[str, str], own: str = "") -> Refusal | None:
        """The refusal for a fact that is not trusted; None if it is trusted.

        `own`: the id of the running command. A fact that this command itself made suspect is accepted, because its
        script is about to correct it.
        """
        fact = self.world.get(key)
        if fact is None or fact.validity in TRUSTED or (own and fact.source.partition("/")[0] == own):
            return None
        location, _, attribute = key.rpartition(".")
        return Refusal(
            reason=RefusalReason.SUSPECT,
            message=f"the {attribute} of {location} is {fact.validity.value} since {fact.source.partition('/')[0]}",
            where=key,
            clears=self.clears(key, clears),
            detail={"validity": fact.validity.value, "source": fact.source, "version": float(fact.version)},
        )

    def clears(self, key: str, clears: Mapping[str, str]) -> str:
        """The remedy that would make this fact trusted again. For a held object, clearing the grasp also clears the
        frame."""
        location, _, attribute = key.rpartition(".")
        holder = self.held_by(location)
        row = attribute
        if attribute in ("frame", "angle"):
            row = "grasp" if holder else "angle" if self.hinge(location) and "angle" in clears else attribute
        if row == "frame" and "seen" in clears and self._look_helps(location):
            row = "seat_seen" if "seat_seen" in clears and self._is_seat(location) else "seen"
        words = clears.get(row, "sense {location} again")
        if "{position}" in words:
            frame = self.pose(location)
            words = words.replace("{position}", _figures(100 * frame[:3]))
            words = words.replace("{attitude}", _figures(np.degrees(geometry.to_rpy(frame))))
        words = words.replace("{angle}", _figures(np.degrees([self.angle(location)])))
        hand = hand_in_words(holder) or "the hand that holds it"
        return words.replace("{location}", location).replace("{holder}", hand)

    def unsure_key(self, body: str) -> str:
        """The fact whose spread makes the place of a body uncertain; empty if it is exact."""
        inside = (thing.name for thing in self.cell.objects if self.seat(thing.name) == body)
        keys = [f"{body}.grasp" if self.held_by(body) else f"{body}.frame", *(f"{name}.frame" for name in inside)]
        return max((key for key in keys if any(self.spread(key))), key=lambda key: max(self.spread(key)), default="")

    def _look_helps(self, body: str) -> bool:
        """Whether a camera can see the body, and a look may say more than is known: a seat stays where one saw it."""
        seen = self._is_seat(body) and self.world.get(f"{body}.sighting") is not None
        return not seen and bool(self.cameras(body))

    def _is_seat(self, body: str) -> bool:
        return any(seat.name == body for seat in self.cell.seats)

    def narrows(self, key: str, clears: Mapping[str, str]) -> str:
        """The remedy that makes the spread of the pose of an object or seat smaller."""
        location, _, _ = key.rpartition(".")
        row = "spread_seen" if "spread_seen" in clears and self._look_helps(location) else "spread"
        return clears.get(row, "sense {location} again").replace("{location}", location)

    # --- for motions ---------------------------------------------------------------------------------------

    def scene(
        self,
        arm: str,
        limits: Limits,
        *,
        touching: str = "",
        seated: bool = False,
        ignore_suspect: bool = False,
        opening_m: float | None = None,
        exempt: Iterable[str] = (),
        unsure: bool = True,
    ) -> Scene:
        """The collision scene from the current facts.

        `touching`: the object that this arm's hand may touch. `seated`: the held object may be in the seat that it is
        in now, or enter a seat of `exempt`.
        `ignore_suspect`: objects with suspect frames are not obstacles. `opening_m`: opening of this arm's hand, if it
        differs from the current one. `exempt`: bodies that the command means to touch. `unsure`: keep as much distance
        as poses are uncertain.
        """
        held: dict[str, Held] = {}
        hung: dict[str, AttachedBody] = {}
        moved_seats = [seat.name for seat in self.cell.seats if self.world.get(f"{seat.name}.frame") is not None]
        poses: dict[str, Array] = {name: self.seat_frame(name) for name in moved_seats}
        for thing in self.cell.objects:
            holder, grasp = self.held_by(thing.name), self.grasp(thing.name)
            if holder and grasp is not None and thing.hinge is None:
                held[thing.name] = Held(holder, grasp)
            elif not thing.fixed:
                if holder and grasp is not None and thing.hinge is not None:
                    grip = geometry.inverse(grasp)[:3]
                    hung[thing.name] = AttachedBody(
                        holder, self.hinge_home(thing.name), thing.hinge.axis, thing.hinge.range_rad, grip
                    )
                poses[thing.name] = self.frame(thing.name)
        openings = {a.name: self.hand_width(a.name) for a in self.cell.arms}
        if opening_m is not None:
            openings[arm] = opening_m
        ignore: list[tuple[str, str]] = []
        carried = self.holding(arm)
        close = [name for name in dict.fromkeys((touching, *exempt)) if name and name not in held]
        if touching:
            ignore += self.hand_contacts(arm, touching)
        doubtful = [
            name for name in poses if ignore_suspect and name not in moved_seats and not self.trusts(f"{name}.frame")
        ]
        ignore += [pair for name in doubtful for pair in ((arm, name), *([(carried, name)] if carried else []))]
        if carried and ignore_suspect and not self.trusts(f"{carried}.grasp"):
            ignore += [(carried, seat.name) for seat in self.cell.seats]
        elif carried and seated:
            ignore += self.seat_contacts(carried, exempt)
        return Scene(
            poses=poses,
            held=held,
            hung=hung,
            openings_m=openings,
            ignore=ignore,
            clearance_m=max(CLEARANCE_M, limits.clearance_m or 0.0),
            near=[*close, *(seat for seat in map(self.seat, filter(None, (*close, carried))) if seat), *hung],
            pose_tolerance_m=self._unsure_m(poses, held) if unsure else {},
            keep_out=limits.keep_out,
            arms_apart_m=ARMS_APART_M,
            moving=arm,
        )

    def seat_contacts(self, carried: str, entered: Iterable[str] = ()) -> list[tuple[str, str]]:
        """The pairs of a held object and a seat that may touch: the seat that it is in, and these ones."""
        seats = {self.seat(carried), self.seat_around(carried), *entered}
        return [(carried, seat.name) for seat in self.cell.seats if seat.name in seats]

    def hand_contacts(self, arm: str, thing: str) -> list[tuple[str, str]]:
        """The pairs of this arm's hand and an object that may touch; its seat too: both poses share an error."""
        hand = self.cell.arm(arm).gripper
        met = [name for name in (thing, self.seat(thing)) if name]
        return [(f"{arm} {link}", name) for name in met for link in (*hand.finger_links, hand.palm_link)]

    def _unsure_m(self, poses: Iterable[str], held: Iterable[str]) -> dict[str, float]:
        """How far any point of a body may be from its believed place: of objects, of the seats that hold them, and of
        held objects."""
        found = {name: self.off_m(name, self.spread(f"{name}.frame")) for name in poses}
        found |= {name: self.off_m(name, self.grasp_spread(name, AHEAD_S)) for name in held}
        for name in list(found):
            if (seat := self.seat(name)) and name not in held:
                found[seat] = max(found[name], found.get(seat, 0.0))
        return {name: off_m for name, off_m in found.items() if off_m > 0.0}

    def off_m(self, body: str, spread: Spread) -> float:
        """How far a point of a body is from its place at most, if its pose has this spread."""
        off_m = math.hypot(*spread[:3]) + math.hypot(*spread[3:]) * self.model.collision.radius_m(body)
        return UNSURE_STEP_M * math.ceil(off_m / UNSURE_STEP_M - 1e-9)

    def path_constraints(self, limits: Limits) -> PathConstraints:
        return PathConstraints(
            work_range=self.cell.region(limits.work_range) if limits.work_range else None,
            attitude=self.cell.attitudes[limits.attitude] if limits.attitude else None,
            attitude_name=limits.attitude or "",
        )

    def planning_request(
        self, arm: str, scene: Scene, limits: Limits, pace: SpeedLimits, margin_rad: float
    ) -> PlanningRequest:
        return PlanningRequest(
            arm=self.model.arms[arm],
            world=self.model.collision,
            joints={a.name: self.joints(a.name) for a in self.cell.arms},
            scene=scene,
            path_constraints=self.path_constraints(limits),
            pace=pace,
            margin_rad=margin_rad,
            load=self.load(arm) if arm in {held.arm for held in scene.held.values()} else None,
            seed=self.seed,
        )


def _figures(values: Array) -> str:
    """Numbers for a sentence: two decimals, without negative zero."""
    return " ".join(f"{round(float(x), 2) + 0:g}" for x in values)
