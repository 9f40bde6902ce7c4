"""The robot models of one cell, built once per cell and worker process, handed to every job that works in that cell.

They are costly to build (URDF texts become models) and never change, so they are not part of a job's state. Built
when first asked for: an analyzer that never checks a collision does not pay for the bodies.
"""

from __future__ import annotations

from functools import cached_property

from rtc.cell import Cell
from rtc.robot.collision import CollisionWorld
from rtc.robot.kinematics import ArmModel


class CellModel:
    """`arms` by name, `collision` of the whole cell, and the `cell` they were built from. For one thread."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell

    @cached_property
    def arms(self) -> dict[str, ArmModel]:
        return {arm.name: ArmModel.of(self.cell, arm.name) for arm in self.cell.arms}

    @cached_property
    def collision(self) -> CollisionWorld:
        return CollisionWorld(self.cell)
