"""Robot and collision models of one cell, built once per cell and worker process and shared by its jobs.

Building them parses URDF and is expensive. They never change, so they are not job state. Each model is built on first
use: an analyzer that never checks collisions does not build the collision bodies.
"""

from __future__ import annotations

from functools import cached_property

from rtc.model.cells.cell import Cell
from rtc.model.robot.collision import CollisionWorld
from rtc.model.robot.kinematics import ArmModel
from workers.planning.sight import Sight


class CellModel:
    """`arms` by name, `collision` and `sight` of all, and the `cell` they were built from. Not thread-safe."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell

    @cached_property
    def arms(self) -> dict[str, ArmModel]:
        return {arm.name: ArmModel.of(self.cell, arm.name) for arm in self.cell.arms}

    @cached_property
    def sight(self) -> Sight:
        return Sight(self.cell)

    @cached_property
    def collision(self) -> CollisionWorld:
        return CollisionWorld(self.cell)
