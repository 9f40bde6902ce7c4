"""Real jobs of the four workers, collected while sentences are executed in memory.

It uses the real worker functions, and reports of the MCM's executor with exact arms. A scenario is seeded: the seed
gives the true places of the modules and the lengths of motions. Trims are not performed: the first deviation from the
plan ends a sentence.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any, NamedTuple

from rtc.drawing.scene import SceneView
from rtc.model.cells.cell import Cell
from rtc.programs import action_stack, loader
from rtc.protocol.messages import (
    Assessment,
    BoundStep,
    ElaboratorInput,
    EndReport,
    ParserInput,
    Script,
    WorkerKind,
    WorldChange,
)
from rtc.protocol.primitive import Look, Primitive
from rtc.subsystems.motion.arm import TICK_S
from rtc.subsystems.motion.executor import Executor
from rtc.world.model import World, initial_facts
from sim_mcm.arms.kinematic_arm import KinematicCell
from sim_mcm.period import period
from tests.workers.eyes import Ideal
from workers.analyzer import analyze
from workers.binder import bind
from workers.elaborator import elaborate
from workers.parser import parse
from workers.planning.robot_models import CellModel

FUNCTIONS: dict[WorkerKind, Any] = {
    WorkerKind.PARSER: parse,
    WorkerKind.ELABORATOR: elaborate,
    WorkerKind.BINDER: bind,
    WorkerKind.ANALYZER: analyze,
}
OFF_M = 0.002  # maximum distance of a module from its believed place, along each axis
LATER_M, LATER_RAD = 0.10, 0.8  # maximum displacement between two views of the world


class WorkerJob(NamedTuple):
    kind: WorkerKind
    world: World
    data: Any


class Workers:
    """The four functions with their own programs compiled, in one cell."""

    def __init__(self, cell: Cell) -> None:
        self.model = CellModel(cell)
        self._compiled = {kind: f.compile(loader.default(kind)) for kind, f in FUNCTIONS.items()}

    def do(self, job: WorkerJob) -> Any:
        """Product or Refusal."""
        return FUNCTIONS[job.kind].run(self._compiled[job.kind], self.model, job.world, job.data)


class Scenario:
    """Sentences executed one after the other; `jobs` are all jobs of the workers, in order."""

    def __init__(self, workers: Workers, rng: random.Random) -> None:
        self._workers, self._rng = workers, rng
        self._cell = workers.model.cell
        self._sim = KinematicCell(self._cell)
        self._executors = {name: Executor(arm) for name, arm in self._sim.arms.items()}
        self._commands = 0
        self._eyes = Ideal(self._cell)
        self.world = World().overlay(initial_facts(self._cell))
        self.jobs: list[WorkerJob] = []
        for thing in self._cell.objects:
            if not thing.fixed:
                self._sim.displace(thing.name, [*(rng.uniform(-OFF_M, OFF_M) for _ in range(3)), 0.0, 0.0, 0.0])

    def run(self, sentence: str) -> bool:
        """Execute a sentence; False if it was not completed as planned."""
        self._commands += 1
        command = f"C-{self._commands}"
        parsed = self._do(WorkerKind.PARSER, ParserInput(text=sentence))
        script = self._do(WorkerKind.ELABORATOR, ElaboratorInput(command=command, parsed=parsed))
        if not isinstance(script, Script):
            return False
        actions = action_stack.begin(script)
        while actions.refs:
            actions.pop()
            data = actions.binder_input(f"{command}.{len(script.steps) - len(actions.refs)}")
            bound = self._do(WorkerKind.BINDER, data)
            if not isinstance(bound, BoundStep):
                return False
            actions.assign(bound.bindings)
            if bound.primitive is None:
                continue
            report = self._perform(bound.primitive, bound.limit_s)
            judged = self._do(WorkerKind.ANALYZER, actions.analyzer_input(bound.evaluation, report))
            if not isinstance(judged, Assessment) or judged.verdict != "continue":
                return False
            self.world = self.world.overlay(judged.changes, source=data.primitive_id)
            actions.assign(judged.keep)
        return True

    def _do(self, kind: WorkerKind, data: Any) -> Any:
        self.jobs.append(WorkerJob(kind, self.world, data))
        return self._workers.do(self.jobs[-1])

    def _perform(self, primitive: Primitive, limit_s: float) -> EndReport:
        if isinstance(primitive.trajectory, Look):
            seen = {name: self._sim.truth()[name] for name in ("poses", "seats", "tcp")}
            return self._eyes.perform(primitive, SceneView(**seen))
        messages: list[Any] = list(self._executors[primitive.performer].accept(primitive, 0.0))
        for tick in range(round(limit_s / TICK_S)):
            for message in messages:
                if isinstance(message, EndReport):
                    return message
            messages = period(self._control, self._sim, tick * TICK_S)
        raise AssertionError(f"no end of {primitive.id} within {limit_s} s")

    def _control(self, now_s: float) -> list[Any]:
        return [message for executor in self._executors.values() for message in executor.tick(now_s)]


def changed(job: WorkerJob, cell: Cell, rng: random.Random) -> WorkerJob:
    """The same bind job in a world where other arms and modules have moved since the planning."""
    arm = job.data.context.arm
    changes = []
    for other in cell.arms:
        if other.name != arm:
            joints = [q + rng.uniform(-LATER_RAD, LATER_RAD) for q in job.world.facts[f"{other.name}.joints"].value]
            changes.append(WorldChange(key=f"{other.name}.joints", value=joints))
    for thing in cell.objects:
        if not thing.fixed and not job.world.facts[f"{thing.name}.held_by"].value:
            x, y, z, *attitude = job.world.facts[f"{thing.name}.frame"].value
            moved = [n + rng.uniform(-LATER_M, LATER_M) for n in (x, y, z)]
            changes.append(WorldChange(key=f"{thing.name}.frame", value=[*moved, *attitude]))
    return job._replace(world=job.world.overlay(changes))


def sentences(rng: random.Random) -> Iterator[str]:
    """Sentences for two arms: each verb with a script, free and guarded motions, a module in the hand."""
    yield "MOVE LEFT-ARM TO BAY-2-FRONT"
    yield "MOVE RIGHT-ARM TO CLEAR-POINT-1"
    yield f"MOVE RIGHT-ARM BY {rng.uniform(2.0, 10.0):.1f} CM ALONG TOOL-Z MAINTAIN SPEED 10 CM/S"
    yield f"RETRACT RIGHT-ARM BY {rng.uniform(2.0, 10.0):.1f} CM"
    yield "STOW LEFT-ARM"
    yield "MOVE RIGHT-ARM TO RACK-1-FRONT"
    yield "APPROACH MACS-NEW WITH RIGHT-ARM"
    yield "GRASP MACS-NEW WITH RIGHT-ARM"
    yield f"LIFT MACS-NEW BY {rng.uniform(15.0, 25.0):.1f} CM WITH RIGHT-ARM"
    yield f"MOVE RIGHT-ARM BY {rng.uniform(2.0, 10.0):.1f} CM ALONG UP"
    yield f"RETRACT RIGHT-ARM BY {rng.uniform(2.0, 10.0):.1f} CM"
    yield "MOVE RIGHT-ARM TO CLEAR-POINT-1"
    yield "PLACE MACS-NEW ON RACK-1 WITH RIGHT-ARM"
    yield "GRASP MACS-NEW WITH RIGHT-ARM"
    yield "RELEASE MACS-NEW"
    yield f"OPEN RIGHT-END-EFF TO {rng.uniform(3.0, 7.0):.1f} CM"
    yield "CLOSE RIGHT-END-EFF MAINTAIN GRIP-FORCE 25 N"
    yield "HOLD RIGHT-ARM FOR 1 SEC"
    yield "MOVE RIGHT-ARM TO BAY-2-FRONT"
    yield "STOW RIGHT-ARM"
    yield "MOVE LEFT-ARM TO RACK-1-FRONT"  # out of its reach
