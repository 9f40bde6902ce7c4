"""Decision Unit, workers and MCM in one process and one time, without sockets: commands on several arms at once.

The parts are the real ones. Time passes in ticks of the MCM. Each job takes some ticks, so the planners of two commands
overlap. A product is computed from the world at the start of its job and delivered at its end.
"""

from __future__ import annotations

import heapq
import itertools
from functools import cache
from typing import Any

import msgspec

from broker.decisions import effects as do
from broker.decisions import events
from broker.decisions.decide import decide
from broker.decisions.state import State
from broker.persistence.program_store import StoredProgram
from broker.router import part_loads
from rtc.drawing.scene import SceneView
from rtc.programs import loader
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import Outcome, Refusal
from rtc.protocol.primitive import JointTrajectory, Primitive
from rtc.protocol.subsystems import CAMERAS
from rtc.protocol.versions import PAUSES
from rtc.subsystems.base.subsystem import BROKER
from rtc.subsystems.motion.arm import TICK_S
from rtc.subsystems.motion.subsystem import McmSubsystem
from rtc.world.model import World, initial_facts
from sim_mcm.period import period
from tests.broker.flat_events import made
from tests.simulation.invariants import violations
from tests.workers.conftest import MODEL, record
from tests.workers.eyes import Ideal
from workers.analyzer import analyze as analyzer
from workers.binder import bind as binder
from workers.elaborator import elaborate as elaborator
from workers.planning.robot_models import CellModel
from workers.rehearsal import rehearse

FUNCTIONS: dict[WorkerKind, Any] = {
    WorkerKind.ELABORATOR: elaborator,
    WorkerKind.BINDER: binder,
    WorkerKind.ANALYZER: analyzer,
}
TICKS = {WorkerKind.PARSER: 2, WorkerKind.ELABORATOR: 15, WorkerKind.BINDER: 15, WorkerKind.ANALYZER: 5}  # of a job
read_primitive = wire.decoder(Primitive)
COMPILED: dict[WorkerKind, Any] = {}  # shared: the programs never change here


def compiled(kind: WorkerKind) -> Any:
    if kind not in COMPILED:
        COMPILED[kind] = FUNCTIONS[kind].compile(loader.default(kind))
    return COMPILED[kind]


@cache
def all_compiled() -> dict[WorkerKind, Any]:
    """The programs of a rehearsal."""
    return {kind: compile(loader.default(kind)) for kind, compile in rehearse.COMPILERS.items()}


class OneProcess:
    """A cell with its arms, and the cluster that commands it.

    `world`: instead of the initial facts of the cell. `eyes`: the cameras; without them no look ends."""

    def __init__(
        self, sim: Any, model: CellModel = MODEL, world: World | None = None, eyes: Ideal | None = None
    ) -> None:
        self.sim, self.model, self.eyes = sim, model, eyes
        self.mcm = McmSubsystem(sim.arms, pid=1)
        self.state = State()
        self.world = world or World().overlay(initial_facts(model.cell))
        self.ticks = 0
        self.outcomes: dict[str, Outcome] = {}
        self.notes: list[m.ProgressNote] = []
        self.moving: dict[str, dict[int, str]] = {name: {} for name in sim.arms}  # arm -> tick -> primitive on its path
        self._number = itertools.count()
        self._due: list[tuple[int, int, events.Event]] = []  # tick, order, event
        self._timers: dict[str, int] = {}
        for kind in WorkerKind:
            self._handle(events.ProgramInstalled(at_s=self.now_s, kind=kind, digest="x"))
        self._handle(events.ListenersChanged(at_s=self.now_s, listening=True))
        self._from_mcm(self.mcm.hello())
        if eyes is not None:
            cameras = [camera.name for camera in model.cell.cameras]
            self._later(
                1, made(events.SubsystemConnected, at_s=self.now_s, subsystem=CAMERAS.name, pid=1, performers=cameras)
            )

    @property
    def now_s(self) -> float:
        return 1.0 + self.ticks * TICK_S

    def give(self, sentence: str, client: str = "ann") -> str:
        """Give a sentence; returns the number of its command."""
        request = f"r{next(self._number)}"
        self._handle(made(events.CommandReceived, at_s=self.now_s, client=client, request=request, text=sentence))
        return f"C-{self.state.accepted}"

    def halt(self, scope: str = "ALL") -> None:
        """A halt at a halt socket."""
        name = f"H-{next(self._number)}"
        self._handle(
            made(events.HaltCalled, at_s=self.now_s, client="ann", halt=name, scope=scope, called_at_s=self.now_s)
        )

    def kill_mcm(self) -> None:
        """The MCM dies, and a new one continues from the state of the hardware."""
        self._handle(events.SubsystemGone(at_s=self.now_s, subsystem="MCM", why="killed"))
        self.sim.restore(self.sim.state())
        self.mcm = McmSubsystem(self.sim.arms, pid=self.mcm.pid + 1)
        self._from_mcm(self.mcm.hello())

    def know_joints(self, joints: dict[str, Any]) -> None:
        """State the position of the arms (rad) in the world."""
        self.know({f"{arm}.joints": [float(q) for q in values] for arm, values in joints.items()})

    def know(self, facts: dict[str, Any]) -> None:
        """State facts in the world."""
        self.world = self.world.overlay([m.WorldChange(key=key, value=value) for key, value in facts.items()])

    def run(self, limit_s: float = 60.0) -> None:
        """Until all commands have ended. Raises AssertionError after the limit."""
        last = self.ticks + round(limit_s / TICK_S)
        while self.state.commands:
            assert self.ticks < last, [(c.id, c.phase.value, c.notes[-1]) for c in self.state.commands.values()]
            self.tick()

    def tick(self) -> None:
        self.ticks += 1
        while self._due and self._due[0][0] <= self.ticks:
            self._handle(heapq.heappop(self._due)[2])
        for timer in [name for name, at in self._timers.items() if at <= self.ticks]:
            del self._timers[timer]
            self._handle(events.TimerFired(at_s=self.now_s, timer=timer))
        self._from_mcm(period(self.mcm.tick, self.sim, self.now_s))
        for name, executor in self.mcm.executors.items():
            on_path = executor.primitive is not None and isinstance(executor.primitive.trajectory, JointTrajectory)
            if executor.moving and on_path and not executor.held_back:
                self.moving[name][self.ticks] = executor.primitive_id

    # --- inside ------------------------------------------------------------------------------------------

    def _handle(self, event: events.Event) -> None:
        for effect in decide(self.state, event):
            self._perform(effect)
        wrong = violations(self.state)
        assert not wrong, wrong

    def _later(self, ticks: int, event: events.Event) -> None:
        heapq.heappush(self._due, (self.ticks + ticks, next(self._number), event))

    def _perform(self, effect: do.Effect) -> None:
        match effect:
            case do.DispatchJob():
                self._later(TICKS[effect.kind], self._worked(effect))
            case do.LoadPart():
                self._later(1, self._loaded(effect))
            case do.SendPrimitive():
                primitive = read_primitive(effect.primitive)
                if effect.subsystem == CAMERAS.name:
                    self._look(primitive)
                    return
                self._from_mcm(self.mcm.handle(m.Execute(primitive=primitive, pid=effect.pid), BROKER, self.now_s))
            case do.SendHalt() if effect.subsystem == CAMERAS.name:
                still = made(
                    events.HaltConfirmed,
                    at_s=self.now_s,
                    subsystem=CAMERAS.name,
                    halt=effect.order.halt,
                    at_rest=True,
                    performers=self.state.subsystems[CAMERAS.name].performers,
                )
                self._later(1, still)
            case do.SendPace() if effect.subsystem != CAMERAS.name:
                paused = m.SetPaused(primitive=effect.primitive, paused=effect.paused)
                self._from_mcm(self.mcm.handle(paused, BROKER, self.now_s))
            case do.SendAnswer():
                self._from_mcm(self.mcm.handle(effect.answer, BROKER, self.now_s))
            case do.SendHalt():
                order = effect.order
                self._from_mcm(self.mcm.handle(order, BROKER, self.now_s))
            case do.AcknowledgeReport() if effect.subsystem != CAMERAS.name:
                self.mcm.handle(m.ReportAck(primitive=effect.primitive), BROKER, self.now_s)
            case do.StartTimer():
                self._timers[effect.timer] = round((effect.at_s - 1.0) / TICK_S)
            case do.StopTimer():
                self._timers.pop(effect.timer, None)
            case do.PublishNote():
                self.notes.append(effect.note)
            case do.ReportEnd():
                self.outcomes[effect.ended.command] = effect.ended.outcome

    def _loaded(self, effect: do.LoadPart) -> events.Event:
        """The load of a delivered part, which never changes these programs."""
        path = loader.part(effect.kind, effect.name)
        assert path is not None
        text = m.ProgramText(request=effect.job, kind=effect.kind, name=path.name, body=b"")
        return part_loads.answer(effect, text, StoredProgram("x", []), self.now_s)

    def _look(self, look: Primitive) -> None:
        assert self.eyes is not None
        truth = self.sim.truth()
        scene = SceneView(**{name: truth[name] for name in ("poses", "seats", "joints", "fingers", "tcp")})
        report = self.eyes.perform(look, scene)
        self._later(1, made(events.PrimitiveStarted, at_s=self.now_s, subsystem=CAMERAS.name, primitive=look.id))
        ticks = max(2, round(report.duration_s / TICK_S))
        self._later(
            ticks, events.PrimitiveEnded(at_s=self.now_s + ticks * TICK_S, subsystem=CAMERAS.name, report=report)
        )

    def _worked(self, job: do.DispatchJob) -> events.Event:
        at_s = self.now_s + TICKS[job.kind] * TICK_S
        if job.queue == m.REHEARSER:
            data = wire.decoder(rehearse.INPUT)(job.input)
            product: Any = rehearse.run(all_compiled(), self.model, self.world, data)
        elif job.kind is WorkerKind.PARSER:
            product = record(msgspec.msgpack.decode(job.input)["text"])
        else:
            function = FUNCTIONS[job.kind]
            data = wire.decoder(function.INPUT)(job.input)
            product = function.run(compiled(job.kind), self.model, self.world, data)
        if isinstance(product, Refusal):
            return events.JobDeclined(at_s=at_s, job=job.job, attempt=job.attempt, node="w", refusal=product)
        if isinstance(product, m.Assessment):
            self.world = self.world.overlay(product.changes, source=job.job, at_s=at_s)
        return events.JobFinished(at_s=at_s, job=job.job, attempt=job.attempt, node="w", product=wire.raw(product))

    def _from_mcm(self, outgoing: Any) -> None:
        for _, message in outgoing:
            if (event := self._event(message)) is not None:
                self._later(1, event)

    def _event(self, message: Any) -> events.Event | None:
        at_s = self.now_s + TICK_S
        match message:
            case m.SubsystemHello():
                return made(
                    events.SubsystemConnected,
                    at_s=at_s,
                    subsystem="MCM",
                    pid=message.pid,
                    performers=message.performers,
                    at_rest=message.at_rest,
                    pauses=PAUSES in message.abilities,
                )
            case m.PauseChanged():
                return events.PrimitivePaced(at_s=at_s, subsystem="MCM", change=message)
            case m.Started():
                return made(events.PrimitiveStarted, at_s=at_s, subsystem="MCM", primitive=message.primitive)
            case m.AnswerRefused():
                return events.AnswerWasRefused(at_s=at_s, primitive=message.primitive, message=message.message)
            case m.EndReport():
                return events.PrimitiveEnded(at_s=at_s, subsystem="MCM", report=message)
            case m.HaltAtRest():
                return made(
                    events.HaltConfirmed,
                    at_s=at_s,
                    subsystem="MCM",
                    halt=message.halt,
                    at_rest=message.at_rest,
                    performers=message.performers,
                )
        return None
