"""What the world is believed to be, as motions need it: joints, hands, frames, and scenes for collision checks. Pure.

Reads facts of one view; decides nothing. A fact that is not to be trusted is told as a Refusal that says what would
clear it. Joints of arms are taken as they were last reported, whatever their validity: a subsystem refuses a
trajectory that does not begin where the arm is, and its report then puts the fact right.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from rtc import cell as cells
from rtc import geometry
from rtc.geometry import Array
from rtc.messages import Limits, Validity
from rtc.outcomes import Refusal, RefusalReason
from rtc.primitive import Load
from rtc.robot.collision import Held, Scene
from rtc.world.model import World
from rtc.world.spread import EXACT, Spread
from workers import axes
from workers.cell_model import CellModel
from workers.motion.constraints import Rules
from workers.motion.plan import PlanningRequest
from workers.motion.timing import Pace

UNKNOWN_RADIUS_M = 0.1  # an object whose inertia nobody has told turns like a ball of this radius
BESIDE_M = 0.04  # what is farther than this from the line of a seat's way out is not in its slot
TRUSTED = (Validity.VALID, Validity.CHANGING)


@dataclass(frozen=True)
class WorldQuery:
    """One view of the world, of one cell."""

    model: CellModel
    world: World

    @property
    def cell(self) -> cells.Cell:
        return self.model.cell

    # --- facts ---------------------------------------------------------------------------------------------

    def joints(self, arm: str) -> list[float]:
        """As last reported (rad); before any report, at home."""
        return self.world.value(f"{arm}.joints") or self.cell.arm(arm).home_rad

    def tcp(self, arm: str) -> Array:
        return self.model.arms[arm].fk(self.joints(arm))

    def hand_width(self, arm: str) -> float:
        width = self.world.value(f"{arm}.hand_width")
        return self.cell.arm(arm).gripper.max_opening_m if width is None else float(width)

    def holding(self, arm: str) -> str:
        return self.world.value(f"{arm}.holding") or ""

    def held_by(self, thing: str) -> str:
        return self.world.value(f"{thing}.held_by") or ""

    def seat(self, thing: str) -> str:
        return self.world.value(f"{thing}.seat") or ""

    def way_out(self, thing: str) -> str:
        """The word for the direction in which a thing leaves the seat it is in, or half in; UP when it is in none."""
        seat = self.seat(thing) or self.seat_around(thing)
        return self.way_out_of(seat) if seat else "UP"

    def way_out_of(self, seat: str) -> str:
        """The word for the direction in which a thing leaves this seat."""
        return axes.name_of(geometry.rotate(self.seat_frame(seat), self.cell.seat(seat).way_out).tolist())

    def seat_around(self, thing: str) -> str:
        """The seat in whose slot a thing is, though it need not sit in it: it was stopped on its way in, or out."""
        for seat in self.cell.seats:
            out = geometry.rotate(self.seat_frame(seat.name), seat.way_out)
            off = self.frame(thing)[:3] - self.seated_pose(seat.name)[:3]
            along = float(off @ out)
            if -BESIDE_M < along < seat.depth_m and float(np.linalg.norm(off - along * out)) < BESIDE_M:
                return seat.name
        return ""

    def seat_frame(self, seat: str) -> Array:
        """Where a seat is believed to be; where the cell has it, unless somebody has told."""
        frame = self.world.value(f"{seat}.frame")
        return self.cell.seat(seat).frame.pose if frame is None else geometry.normalise(frame)

    def seated_pose(self, seat: str) -> Array:
        """Where a thing is that sits in this seat (world)."""
        return geometry.compose(self.seat_frame(seat), self.cell.seat(seat).module_frame.pose)

    def frame(self, thing: str) -> Array:
        """Where an object is believed to be, trusted or not; before anything was told, where the cell has it."""
        frame = self.world.value(f"{thing}.frame")
        return self.cell.object_pose(thing) if frame is None else geometry.normalise(frame)

    def spread(self, key: str) -> Spread:
        """How well the pose of this fact is known; exactly, where nobody has stated otherwise."""
        fact = self.world.get(key)
        return EXACT if fact is None or fact.spread is None else fact.spread

    def grasp(self, thing: str) -> Array | None:
        """The held object's frame in tcp axes."""
        grasp = self.world.value(f"{thing}.grasp")
        return None if grasp is None else geometry.normalise(grasp)

    def point_in_hand(self, thing: str) -> cells.GraspPoint | None:
        """The grasp point that is between the fingers, as nearly as the grasp tells."""
        grasp = self.grasp(thing)
        if grasp is None:
            return None
        points = self.cell.object(thing).grasp_points
        return min(points, key=lambda p: math.hypot(*geometry.compose(grasp, p.frame.pose)[:3]), default=None)

    def load(self, arm: str) -> Load | None:
        """What the arm's servo should know of what its hand holds."""
        thing = self.holding(arm)
        grasp = self.grasp(thing) if thing else None
        if grasp is None:
            return None
        known = self.cell.object(thing)
        mass_kg = float(self.world.value(f"{thing}.mass") or known.mass_kg)
        turn = geometry.to_matrix(grasp)[:3, :3]
        own = np.diag(known.inertia_kg_m2 or [0.4 * mass_kg * UNKNOWN_RADIUS_M**2] * 3)
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = (turn @ own @ turn.T).tolist()
        return Load(mass_kg=mass_kg, com_m=grasp[:3].tolist(), inertia_kg_m2=[xx, yy, zz, xy, xz, yz])

    def trusts(self, key: str) -> bool:
        """Whether this fact can be built upon, whoever asks."""
        return self.distrusted(key, {}) is None

    def distrusted(self, key: str, clears: Mapping[str, str], own: str = "") -> Refusal | None:
        """Why this fact cannot be built upon; None when it can. A doubt that the command `own` has itself raised is no
        reason: its script has foreseen it, and is about to mend it."""
        fact = self.world.get(key)
        if fact is None or fact.validity in TRUSTED or (own and fact.source.partition("/")[0] == own):
            return None
        location, _, attribute = key.rpartition(".")
        return Refusal(
            reason=RefusalReason.SUSPECT,
            message=f"the {attribute} of {location} is {fact.validity.value} since {fact.source.partition('/')[0]}",
            where=key,
            clears=self.cure(key, clears),
            detail={"validity": fact.validity.value, "source": fact.source, "version": float(fact.version)},
        )

    def cure(self, key: str, clears: Mapping[str, str]) -> str:
        """What would make this fact trusted again, in words. Where a held thing is follows from how it is held."""
        location, _, attribute = key.rpartition(".")
        holder = self.held_by(location)
        words = clears.get("grasp" if attribute == "frame" and holder else attribute, "sense {location} again")
        if "{position}" in words:
            frame = self.frame(location)
            words = words.replace("{position}", _figures(100 * frame[:3]))
            words = words.replace("{attitude}", _figures(np.degrees(geometry.to_rpy(frame))))
        return words.replace("{location}", location).replace("{holder}", holder or "the hand that holds it")

    # --- for motions ---------------------------------------------------------------------------------------

    def scene(
        self,
        arm: str,
        limits: Limits,
        *,
        touching: str = "",
        seated: bool = False,
        away: bool = False,
        opening_m: float | None = None,
        near: Iterable[str] = (),
    ) -> Scene:
        """Everything as believed. `touching`: the object that this arm's hand may touch; `seated`: what the hand
        holds may be in, or come into, a seat; `away`: what is in doubt is no obstacle; `opening_m`: of this arm's hand,
        if not as it is now; `near`: what it need keep no clearance to."""
        held: dict[str, Held] = {}
        told = [seat.name for seat in self.cell.seats if self.world.get(f"{seat.name}.frame") is not None]
        poses: dict[str, Array] = {name: self.seat_frame(name) for name in told}
        for thing in self.cell.objects:
            holder, grasp = self.held_by(thing.name), self.grasp(thing.name)
            if holder and grasp is not None:
                held[thing.name] = Held(holder, grasp)
            elif not thing.fixed:
                poses[thing.name] = self.frame(thing.name)
        openings = {a.name: self.hand_width(a.name) for a in self.cell.arms}
        if opening_m is not None:
            openings[arm] = opening_m
        ignore: list[tuple[str, str]] = []
        carried = self.holding(arm)
        close = [name for name in dict.fromkeys((touching, *near)) if name]
        if touching:  # whose seat stands where it stands, if that is not where both are believed to be
            hand = self.cell.arm(arm).gripper
            met = filter(None, (touching, self.seat(touching)))
            ignore += [(f"{arm} {link}", name) for name in met for link in (*hand.finger_links, hand.palm_link)]
        doubtful = [name for name in poses if away and name not in told and not self.trusts(f"{name}.frame")]
        ignore += [pair for name in doubtful for pair in ((arm, name), *([(carried, name)] if carried else []))]
        if carried and (seated or (away and not self.trusts(f"{carried}.grasp"))):
            ignore += [(carried, seat.name) for seat in self.cell.seats]
        return Scene(
            poses=poses,
            held=held,
            openings_m=openings,
            ignore=ignore,
            clearance_m=limits.clearance_m or 0.0,
            near=[*close, *(seat for seat in map(self.seat, filter(None, (*close, carried))) if seat)],
            keep_out=limits.keep_out,
            moving=arm,
        )

    def rules(self, limits: Limits) -> Rules:
        return Rules(
            work_range=self.cell.region(limits.work_range) if limits.work_range else None,
            attitude=self.cell.attitudes[limits.attitude] if limits.attitude else None,
            attitude_name=limits.attitude or "",
        )

    def planning_request(
        self, arm: str, scene: Scene, limits: Limits, pace: Pace, margin_rad: float
    ) -> PlanningRequest:
        return PlanningRequest(
            arm=self.model.arms[arm],
            world=self.model.collision,
            joints={a.name: self.joints(a.name) for a in self.cell.arms},
            scene=scene,
            rules=self.rules(limits),
            pace=pace,
            margin_rad=margin_rad,
        )


def _figures(values: Array) -> str:
    """Numbers as a sentence says them: to a hundredth, without a minus before nothing."""
    return " ".join(f"{round(float(x), 2) + 0:g}" for x in values)
