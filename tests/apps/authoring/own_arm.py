"""Sentences performed by an arm of another cell, in physics, in one process."""

from __future__ import annotations

from rtc.model.cells.cell import Cell
from rtc.subsystems.motion.executor import Executor
from rtc.subsystems.motion.two_arms import Pairs
from rtc.world.model import World, initial_facts
from sim_mcm.arms.bullet_arm import BulletCell
from tests.workers import conftest as workers
from workers.planning.robot_models import CellModel


class OwnArm(workers.Bench):
    """The loop of the paper on the physics of another cell."""

    def __init__(self, cell: Cell) -> None:
        super().__init__(_Physics(cell))
        self.model = CellModel(cell)
        self.world = World().overlay(initial_facts(cell))


class _Physics(workers.Kinematic):
    def __init__(self, cell: Cell) -> None:
        self.disturb = None
        self.sim = BulletCell(cell)  # type: ignore[assignment]
        self.executors = {name: Executor(arm) for name, arm in self.sim.arms.items()}
        self.pairs = Pairs(self.executors)
