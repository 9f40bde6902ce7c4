"""The jobs of the real workload of `benchmarks.scaling`, with their products: motions of two arms, alone and beside.

A job of a planner is *beside* if it carries a motion of the other arm. Made by the functions of the workers, in this
process.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import msgspec

from benchmarks.throughput import MOTIONS
from rtc.model.cells.cell import Cell
from rtc.programs import loader
from rtc.protocol import messages as m
from rtc.protocol.messages import WorkerKind
from rtc.protocol.primitive import Primitive
from rtc.protocol.sentence import ParsedCommand
from rtc.world.model import World, initial_facts
from workers.binder import bind
from workers.elaborator import elaborate
from workers.parser import parse
from workers.planning.robot_models import CellModel

CELL = "swapout"  # the default cell, as in the benchmark
ARMS = len(MOTIONS)  # each sentence moves another arm


class Motions:
    """`n`: number of the sentence. All products are for commands whose arms are at their home positions."""

    def __init__(self) -> None:
        self.cell = Cell.load(CELL)
        self._model = CellModel(self.cell)
        self._world = World().overlay(initial_facts(self.cell))
        self._programs = {kind: loader.default(kind) for kind in (WorkerKind.ELABORATOR, WorkerKind.BINDER)}
        self._grammar = parse.compile(loader.default(WorkerKind.PARSER))
        self._scripts: dict[tuple[int, bool], m.Script] = {}

    @property
    def performers(self) -> list[str]:
        return [arm.name for arm in self.cell.arms]

    def record(self, n: int) -> ParsedCommand:
        found = parse.parse_job(self._grammar, MOTIONS[n])
        assert isinstance(found, ParsedCommand), found
        return found

    @cached_property
    def primitives(self) -> list[Primitive]:
        """The motion of each arm alone."""
        found = [self.bound(n, self.binder_input(n)).primitive for n in range(ARMS)]
        assert all(found)
        return found  # type: ignore[return-value]

    def _beside(self, n: int) -> list[Primitive]:
        return [primitive for other, primitive in enumerate(self.primitives) if other != n]

    def elaborator_input(self, n: int, beside: bool = False) -> m.ElaboratorInput:
        moving = self._beside(n) if beside else []
        return m.ElaboratorInput(command=f"C-{n + 1}", parsed=self.record(n), moving=moving)

    def script(self, n: int, beside: bool = False) -> m.Script:
        """The elaborator's product."""
        if (n, beside) not in self._scripts:
            found = elaborate.run(self._elaborator, self._model, self._world, self.elaborator_input(n, beside))
            assert isinstance(found, m.Script), found
            self._scripts[n, beside] = found
        return self._scripts[n, beside]

    def binder_input(self, n: int, beside: bool = False, known: bool = True) -> m.BinderInput:
        """`known`: the way of the elaborator can be used, because the other arm was doing the same then."""
        script = self.script(n, beside if known else not beside)
        moving = self._beside(n) if beside else []
        (step,) = script.steps
        return m.BinderInput(
            primitive_id=f"C-{n + 1}.1",
            context=script.context,
            step=step,
            bindings=script.bindings,
            moving=moving,
        )

    def bound(self, n: int, data: m.BinderInput) -> m.BoundStep:
        """The binder's product."""
        found = bind.run(self._binder, self._model, self._world, data)
        assert isinstance(found, m.BoundStep), found
        return found

    @cached_property
    def _elaborator(self) -> Any:
        return elaborate.compile(self._programs[WorkerKind.ELABORATOR])

    @cached_property
    def _binder(self) -> Any:
        return bind.compile(self._programs[WorkerKind.BINDER])


def named(product: m.BoundStep, primitive: str) -> m.BoundStep:
    """The same product for the primitive of another command."""
    made = product.primitive
    assert made is not None
    return msgspec.structs.replace(product, primitive=msgspec.structs.replace(made, id=primitive))
