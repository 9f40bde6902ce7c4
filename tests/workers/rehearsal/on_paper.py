"""Lists of TEST sentences rehearsed in one process, each in the world after those before it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rtc.model.cells.cell import Cell
from rtc.programs import loader
from rtc.protocol import wire
from rtc.protocol.messages import Paper, RehearsalInput, Rehearsed, Validity, WorkerKind, WorldChange
from rtc.protocol.primitive import Primitive
from rtc.world.model import World, initial_facts
from tests.workers.conftest import MODEL, record
from workers.planning.robot_models import CellModel
from workers.rehearsal import rehearse

PROGRAMS = {kind: compile(loader.default(kind)) for kind, compile in rehearse.COMPILERS.items()}
read = wire.decoder(Rehearsed)


class OnPaper:
    """`world` is that of the database. It never changes, whatever is rehearsed."""

    def __init__(self, model: CellModel = MODEL) -> None:
        self.model = model
        changes = [*initial_facts(model.cell)]
        self.world = World(version=7).overlay(changes, "cell", 0.0)
        self.programs: dict[WorkerKind, Any] = dict(PROGRAMS)
        self.paper: Paper | None = None
        self.rigid: list[str] = []  # arms of an exact MCM

    def know(self, key: str, value: Any = None, validity: Validity = Validity.VALID) -> None:
        change = WorldChange(key=key, value=value, keep_value=value is None, validity=validity)
        self.world = self.world.overlay([change], "C-9/1")

    def test(
        self, sentence: str, label: str = "", moving: Sequence[Primitive] = (), live: Sequence[str] = ()
    ) -> Rehearsed:
        """Rehearse a sentence, given without TEST, as bytes; what it leaves is there for the next one."""
        data = RehearsalInput(
            command="C-101",
            text=f"TEST {sentence}",
            parsed=record(f"TEST {sentence}"),
            label=label,
            at_s=100.0,
            moving=list(moving),
            live=list(live),
            before=self.paper,
            rigid=self.rigid,
        )
        found: Rehearsed = read(wire.encode(rehearse.run(self.programs, self.model, self.world, data)))
        self.paper = found.after
        return found


SERVICING = CellModel(Cell.load("servicing"))
