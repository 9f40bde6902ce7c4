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
from workers.planning.sight import Sight

Piece = TypeVar("Piece", bound=msgspec.Struct)


class Driver(NamedTuple):
    """The magnitudes of the axis of a spindle (unit vector, object's axes), and how far a point of the driver is from
    it at most (m)."""

    axis: Array
    aside_m: float


class CellModel:
    """`arms` by name, `collision` and `sight` of all, and the `cell` they were built from. Not thread-safe."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self._pieces: dict[str, Any] = {}

    def piece(self, mechanism: str, form: type[Piece]) -> Piece:
        """The piece of the cell file for the mechanism of a package; without one, what `form` has as defaults. Raises
        msgspec.ValidationError."""
        if mechanism not in self._pieces:
            self._pieces[mechanism] = msgspec.convert(self.cell.mechanisms.get(mechanism, {}), form)
        return cast("Piece", self._pieces[mechanism])

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
        return CollisionWorld(self.cell)


def _driver(thing: parts.Object, spindle: parts.Spindle) -> Driver:
    axis = geometry.rotate(spindle.frame.pose, (0.0, 0.0, 1.0))
    aside = (np.linalg.norm(np.cross(shape.frame.xyz, axis)) + parts.radius_m(shape) for shape in thing.shapes)
    return Driver(np.abs(axis), float(max(aside)))
