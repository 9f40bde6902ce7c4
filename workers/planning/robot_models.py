"""Robot and collision models of one cell, built once per cell and worker process and shared by its jobs.

Building them parses URDF and is expensive. They never change, so they are not job state. Each model is built on first
use: an analyzer that never checks collisions does not build the collision bodies.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple, TypeVar, cast

import msgspec
import numpy as np

from rtc.model.cells import parts
from rtc.model.cells.cell import Cell
from rtc.model.robot.collision import CollisionWorld
from rtc.model.robot.kinematics import ArmModel
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.world.model import World
from workers.planning.sight import Sight

Piece = TypeVar("Piece", bound=msgspec.Struct)


class Driver(NamedTuple):
    """The magnitudes of the axis of a spindle (unit vector, object's axes), and how far a point of the driver is from
    it at most (m)."""

    axis: Array
    aside_m: float


Hands = tuple[tuple[str, str], ...]  # of the arms with a coupler: (arm, the hand in it, or empty)


class CellModel:
    """`arms` by name, `collision` and `sight` of all, and the `cell` they were built from. Not thread-safe.

    Arms with a coupler have the hands of `hands`: a cell with other hands is another cell, and its models are kept,
    too."""

    def __init__(self, cell: Cell, hands: Hands = (), family: dict[Hands, CellModel] | None = None) -> None:
        self.cell = cell
        self._pieces: dict[str, Any] = {}
        #: hands in couplers: an arm has them, so they are no objects of the scene
        self.coupled = frozenset(hand for _, hand in hands if hand)
        self._couplers = [arm.name for arm in cell.arms if arm.hands]
        self._none: Hands = tuple((name, "") for name in self._couplers)
        self._family = {self._none: self} if family is None else family

    def piece(self, mechanism: str, form: type[Piece]) -> Piece:
        """The piece of the cell file for the mechanism of a package; without one, what `form` has as defaults. Raises
        msgspec.ValidationError."""
        if mechanism not in self._pieces:
            self._pieces[mechanism] = msgspec.convert(self.cell.mechanisms.get(mechanism, {}), form)
        return cast("Piece", self._pieces[mechanism])

    def as_in(self, world: World) -> CellModel:
        """The model with the hands that the arms have in this world."""
        if not self._couplers:
            return self
        hands = tuple((name, world.value(f"{name}.hand") or "") for name in self._couplers)
        if hands not in self._family:
            cell = self._family[self._none].cell.with_hands(dict(hands))
            self._family[hands] = CellModel(cell, hands, self._family)
        return self._family[hands]

    @cached_property
    def arms(self) -> dict[str, ArmModel]:
        return {arm.name: ArmModel.of(self.cell, arm.name) for arm in self.cell.arms}

    @cached_property
    def drivers(self) -> dict[str, Driver]:
        """The objects with a spindle."""
        return {thing.name: _driver(thing, thing.spindle) for thing in self.cell.objects if thing.spindle is not None}

    @cached_property
    def sight(self) -> Sight:
        return Sight(self.cell)

    @cached_property
    def collision(self) -> CollisionWorld:
        return CollisionWorld(self.cell.without_objects(self.coupled) if self.coupled else self.cell)


def _driver(thing: parts.Object, spindle: parts.Spindle) -> Driver:
    axis = geometry.rotate(spindle.frame.pose, (0.0, 0.0, 1.0))
    aside = (np.linalg.norm(np.cross(shape.frame.xyz, axis)) + parts.radius_m(shape) for shape in thing.shapes)
    return Driver(np.abs(axis), float(max(aside)))
