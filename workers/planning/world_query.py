"""The facts of a cell together with its robot models: what a planning job asks. Pure.

Joints are used as last reported, even if they are not valid. A subsystem refuses a trajectory that does not start at
the arm's position, and its report then corrects the fact.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from rtc.model.cells import parts
from rtc.programs.schema import OWN_ALONE, Algorithms
from rtc.protocol.messages import Validity, WorldChange
from rtc.protocol.primitive import Load, Primitive
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.world.facts import Facts
from rtc.world.model import World, moved_with
from workers.planning import axes, sight
from workers.planning.robot_models import CellModel

UNKNOWN_RADIUS_M = 0.1  # an object of unknown inertia is modelled as a solid ball of this radius


class WorldQuery(Facts):
    """The facts of one world view, read with the models of the cell.

    `seed`: of the sampling planner in this job. `moving`: the primitives that other arms execute now. `algorithms`:
    who plans, as the program of the job names them.
    """

    def __init__(
        self,
        model: CellModel,
        world: World,
        seed: int = 0,
        moving: Sequence[Primitive] = (),
        algorithms: Algorithms = OWN_ALONE,
    ) -> None:
        self.model = model = model.as_in(world)
        super().__init__(model.cell, world)
        self.seed = seed
        self.moving = moving
        self.algorithms = algorithms
        self._tcps: dict[str, Array] = {}
        self._cameras: dict[str, list[parts.Camera]] = {}
        arms = {arm for primitive in moving for arm in primitive.paths}
        self._changing = moved_with(world.facts, arms) if arms else {}

    def mover_of(self, key: str) -> str:
        """The arm of another command whose motion changes this fact now; empty: the fact rests."""
        return self._changing.get(key, "")

    def placed(self, body: str) -> bool:
        """Whether its pose is a belief: neither unknown nor disproved."""
        fact = self.world.get(f"{body}.frame")
        return fact is None or fact.validity not in (Validity.UNKNOWN, Validity.INVALID)

    def after(self, changes: Iterable[WorldChange]) -> WorldQuery:
        """The same query in the world after these changes."""
        return WorldQuery(self.model, self.world.overlay(changes), self.seed, self.moving, self.algorithms)

    def joints(self, arm: str) -> list[float]:
        """Joint values as last reported (rad); the home position before any report. Of a moving arm: at its goal."""
        for primitive in self.moving:
            if (path := primitive.paths.get(arm)) is not None:
                return path.positions[-1]
        return super().joints(arm)

    def tcp(self, arm: str) -> Array:
        """Pose of the tcp at `joints`; read-only."""
        if arm not in self._tcps:
            pose = self._tcps[arm] = self.model.arms[arm].fk(self.joints(arm))
            pose.setflags(write=False)
        return self._tcps[arm]

    def hand_planned_with(self, arm: str) -> str | None:
        """The hand in the coupler of an arm, believed or known: its subsystem refuses what was planned with another
        one. Empty: none; None: it has no coupler."""
        return self.hand(arm) if self.cell.arm(arm).hands else None

    def way_out(self, thing: str) -> str:
        """Name of the direction in which an object leaves the seat that it is in or partly in; UP without a seat."""
        seat = self.seat(thing) or self.seat_around(thing)
        return self.way_out_of(seat) if seat else "UP"

    def way_out_of(self, seat: str) -> str:
        """Name of the direction in which an object leaves this seat."""
        return axes.name_of(self.out_of(seat).tolist())

    def cameras(self, body: str) -> list[parts.Camera]:
        """The cameras that can see an object or seat where it is believed to be, the best one first. If there is no
        such place, all cameras: any of them may find it."""
        if body not in self._cameras:
            found = self.model.sight.cameras(body, self.pose(body), self.tcp)
            if not self.placed(body) and sight.tags(self.cell, body):
                found = [*found, *(camera for camera in self.cell.cameras if camera not in found)]
            self._cameras[body] = found
        return self._cameras[body]

    def finds(self, body: str) -> bool:
        """Whether a camera can see the body where it is believed to be, and the last look has not missed it."""
        fact = self.world.get(f"{body}.sighting")
        missed = fact is not None and fact.value is None and fact.validity is not Validity.UNKNOWN
        return not missed and bool(self.cameras(body))

    def load(self, arm: str) -> Load | None:
        """Mass, centre of mass and inertia of the held object in the tcp frame; None if its hinge carries it."""
        thing, grasp = self.holding(arm), self._load_at(arm)
        if grasp is None:
            return None
        known = self.cell.object(thing)
        mass_kg = float(self.world.value(f"{thing}.mass") or known.mass_kg)
        turn = geometry.to_matrix(grasp)[:3, :3]
        own = np.diag(known.inertia_kg_m2 or [0.4 * mass_kg * UNKNOWN_RADIUS_M**2] * 3)
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = (turn @ own @ turn.T).tolist()
        return Load(mass_kg=mass_kg, com_m=grasp[:3].tolist(), inertia_kg_m2=[xx, yy, zz, xy, xz, yz])

    def load_boxes(self, arm: str) -> list[list[float]]:
        """Boxes round the shapes of the held object, in the tcp frame: pose and sides (m); none if its hinge carries
        it."""
        if (grasp := self._load_at(arm)) is None:
            return []
        shapes = self.cell.object(self.holding(arm)).shapes
        return [[*geometry.compose(grasp, one.frame.pose).tolist(), *parts.sides_m(one)] for one in shapes]

    def _load_at(self, arm: str) -> Array | None:
        """The pose in the tcp frame of what an arm holds and carries; None: nothing."""
        thing = self.holding(arm)
        grasp = self.grasp(thing) if thing and self.hinge(thing) is None else None
        if grasp is not None and (holder := self.held_by(thing)) not in ("", arm):
            # Both hold it; the grasp is that of the other hand.
            return geometry.relative(self.tcp(arm), geometry.compose(self.tcp(holder), grasp))
        return grasp
