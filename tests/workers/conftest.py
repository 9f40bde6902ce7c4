"""The loop of the paper, section 4, in memory: the real three workers, and a subsystem to report to them.

`Reporter` makes perfect reports from geometry alone, for pure tests in milliseconds; `Kinematic` is the MCM's own
executor over arms that follow exactly. The same tests run on both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from types import ModuleType
from typing import Any

import msgspec
import numpy as np
import pytest

from rtc.drawing.scene import SceneView
from rtc.model.cells.cell import Cell
from rtc.programs import action_stack, loader
from rtc.protocol.messages import (
    AnalyzerInput,
    Assessment,
    BinderInput,
    Binding,
    BoundStep,
    ElaboratorInput,
    EndReport,
    ProgressReport,
    SavedWorld,
    Script,
    Step,
    Validity,
    WorldChange,
)
from rtc.protocol.outcomes import Refusal, StopReason
from rtc.protocol.primitive import ForceAbove, HandMotion, HoldStill, JointTrajectory, Look, Primitive
from rtc.protocol.sentence import ParsedCommand
from rtc.spatial import geometry
from rtc.subsystems.motion.executor import Executor
from rtc.subsystems.motion.two_arms import Pairs
from rtc.world.model import World, initial_facts
from sim_mcm.arms.kinematic_arm import KinematicCell
from sim_mcm.period import period
from tests.workers.eyes import Drawn, Ideal
from workers.analyzer import analyze as analyzer
from workers.binder import bind as binder
from workers.elaborator import elaborate as elaborator
from workers.parser import parse as parser
from workers.planning.robot_models import CellModel

CELL = Cell.load("swapout")
MODEL = CellModel(CELL)
SIGHTLESS = CellModel(msgspec.structs.replace(CELL, cameras=[]))
GRAMMAR = loader.default("parser").decode()


def record(sentence: str, grammar: str = GRAMMAR) -> ParsedCommand:
    parsed = parser.parse_job(grammar, sentence)
    assert isinstance(parsed, ParsedCommand), parsed
    return parsed


class Reporter:
    """Says what a perfect arm would say, from where things truly are. Of what is there it knows one object's bar."""

    def __init__(self, cell: Cell = CELL) -> None:
        self.cell = cell
        self.poses = {thing.name: cell.object_pose(thing.name) for thing in cell.objects}
        self.joints = {arm.name: np.array(arm.home_rad) for arm in cell.arms}
        self.widths = {arm.name: arm.gripper.max_opening_m for arm in cell.arms}
        self.forces = {arm.name: 0.0 for arm in cell.arms}  # of the hands (N)
        self.closes: list[float] = []  # what the next closures come to, instead of the truth
        self.instead: dict[str, StopReason] = {}  # primitive -> how it ends instead, at its start
        self.seats = True  # what is brought down in a seat touches it, and is caught
        self.eyes = Ideal(cell)

    def displace(self, name: str, by: list[float]) -> None:
        self.poses[name] = geometry.translate(self.poses[name], by)

    def perform(self, made: Primitive, bound: BoundStep) -> EndReport:
        assert bound.evaluation is not None
        if isinstance(made.trajectory, Look):
            tcp = {name: MODEL.arms[name].fk(joints).tolist() for name, joints in self.joints.items()}
            poses = {name: pose.tolist() for name, pose in self.poses.items()}
            return self.eyes.perform(made, SceneView(poses=poses, tcp=tcp))
        arm, trajectory = made.performer, made.trajectory
        reason = self.instead.get(made.id, StopReason.GOAL)
        if reason is StopReason.GOAL and isinstance(trajectory, JointTrajectory):
            before = MODEL.arms[arm].fk(self.joints[arm])
            reason = self._move(arm, trajectory, made, bound)
            if held := bound.evaluation.held:
                in_hand = geometry.relative(before, self.poses[held])
                self.poses[held] = geometry.compose(MODEL.arms[arm].fk(self.joints[arm]), in_hand)
        elif reason is StopReason.GOAL and isinstance(trajectory, HandMotion):
            self.forces[arm] = self._hand(arm, trajectory, bound)
        else:
            assert isinstance(trajectory, HoldStill) or made.id in self.instead
        partner = None
        if reason is StopReason.GOAL and made.partner is not None:
            other = made.partner.performer
            self.joints[other] = np.array(made.paths[other].positions[-1])
            partner = self._report(made, other, reason, bound)
        return msgspec.structs.replace(self._report(made, arm, reason, bound), partner=partner)

    def _report(self, made: Primitive, arm: str, reason: StopReason, bound: BoundStep) -> EndReport:
        assert bound.evaluation is not None
        pose = MODEL.arms[arm].fk(self.joints[arm]).tolist()
        return EndReport(
            primitive=made.id,
            performer=arm,
            reason=reason,
            at_s=0.0,
            duration_s=bound.evaluation.predicted_s,
            joints=self.joints[arm].tolist(),
            tcp_pose=pose,
            wrench=[0.0] * 6,
            hand_width_m=self.widths[arm],
            hand_force_n=self.forces[arm],
            trip_pose=pose,
        )

    def _move(self, arm: str, way: JointTrajectory, made: Primitive, bound: BoundStep) -> StopReason:
        assert np.allclose(way.positions[0], self.joints[arm], atol=1e-6), "it must begin where the arm is"
        feels = any(s.reason is StopReason.CONTACT and isinstance(s.when, ForceAbove) for s in made.stop_functions)
        for before, after in zip(way.positions, way.positions[1:], strict=False):
            if feels and self._touches(arm, np.array(after), bound) and not self._touches(arm, np.array(before), bound):
                self.joints[arm] = self._first_touch(arm, np.array(before), np.array(after), bound)
                return StopReason.CONTACT
        self.joints[arm] = np.array(way.positions[-1])
        assert bound.evaluation is not None
        seat = bound.evaluation.held and feels and bound.evaluation.no_contact_is_failure
        return StopReason.CONTACT if seat and self.seats else StopReason.GOAL

    def _aside(self, arm: str, joints: Any, bound: BoundStep) -> float:
        """How far the grasp point's bar is from the middle between the fingers (m)."""
        assert bound.evaluation is not None
        context = bound.evaluation.context
        thing, tcp = self.cell.object(context.object), MODEL.arms[arm].fk(joints)
        true = [geometry.compose(self.poses[thing.name], point.frame.pose) for point in thing.grasp_points]
        if context.grasp_point:
            at = [point.name for point in thing.grasp_points].index(context.grasp_point)
        else:
            at = min(range(len(true)), key=lambda n: geometry.distance(tcp, true[n]))
        return abs(float(geometry.relative(true[at], tcp)[1]))

    def _touches(self, arm: str, joints: Any, bound: BoundStep) -> bool:
        assert bound.evaluation is not None
        context = bound.evaluation.context
        if not context.object or not context.grasp_point:
            return False
        width = self.cell.object(context.object).grasp_point(context.grasp_point).width_m
        return self._aside(arm, joints, bound) > 0.5 * (self.widths[arm] - width)

    def _first_touch(self, arm: str, free: Any, touching: Any, bound: BoundStep) -> Any:
        for _ in range(20):
            middle = 0.5 * (free + touching)
            free, touching = (free, middle) if self._touches(arm, middle, bound) else (middle, touching)
        return touching

    def _hand(self, arm: str, motion: HandMotion, bound: BoundStep) -> float:
        assert bound.evaluation is not None
        context = bound.evaluation.context
        between = 0.0
        if motion.width_m == 0.0 and bound.evaluation.held:
            between = self.widths[arm]
        elif motion.width_m == 0.0 and context.object:
            thing = self.cell.object(context.object)
            bar = (thing.grasp_point(context.grasp_point) if context.grasp_point else thing.grasp_points[0]).width_m
            between = bar if self._aside(arm, self.joints[arm], bound) < 0.04 else 0.0
        if motion.width_m == 0.0 and self.closes:
            between = self.closes.pop(0)
        self.widths[arm] = max(motion.width_m, between)
        return motion.force_n if between else 0.0


class Kinematic:
    """The MCM's executor over kinematic arms: the real subsystem, without its socket."""

    def __init__(self, cell: Cell = CELL) -> None:
        self.sim = KinematicCell(cell)
        self.executors = {name: Executor(arm) for name, arm in self.sim.arms.items()}
        self.pairs = Pairs(self.executors)
        self.disturb: Callable[[int], None] | None = None  # called before each period, with the tick of the primitive
        self.eyes = Ideal(cell)

    @property
    def poses(self) -> dict[str, Any]:
        return self.sim.poses

    def displace(self, name: str, by: list[float]) -> None:
        self.displace_and_turn(name, [*by, 0.0, 0.0, 0.0])

    def displace_and_turn(self, name: str, offset: list[float]) -> None:
        assert not self.sim.displace(name, offset)

    def perform(self, made: Primitive, bound: BoundStep) -> EndReport:
        if isinstance(made.trajectory, Look):
            truth = self.sim.truth()
            return self.eyes.perform(
                made, SceneView(**{name: truth[name] for name in ("poses", "seats", "joints", "fingers", "tcp")})
            )
        begin = self.executors[made.performer].accept if made.partner is None else self.pairs.begin
        messages: list[Any] = list(begin(made, 0.0))
        self.progress: list[ProgressReport] = []  # of this primitive
        for tick in range(int(bound.limit_s * 1000)):
            self.progress += [m for m in messages if isinstance(m, ProgressReport)]
            ends = [self.pairs.whole(m) for m in messages if isinstance(m, EndReport)]
            if whole := [end for end in ends if end is not None]:
                return whole[0]
            if self.disturb is not None:
                self.disturb(tick)
            messages = self.tick(tick * 0.001)
        raise AssertionError(f"no end report of {made.id} within {bound.limit_s} s")

    def tick(self, now_s: float = 0.0) -> list[Any]:
        """One period of all arms; returns what they report."""
        return period(self._control, self.sim, now_s)

    def _control(self, now_s: float) -> list[Any]:
        messages = [m for executor in self.executors.values() for m in executor.tick(now_s)]
        self.pairs.couple()
        return messages


class Physical(Kinematic):
    """The same in physics."""

    def __init__(self, cell: Cell = CELL) -> None:
        from sim_mcm.arms.bullet_arm import BulletCell

        self.disturb = None
        self._cell = cell
        self.sim = BulletCell(cell)  # type: ignore[assignment]
        self.executors = {name: Executor(arm) for name, arm in self.sim.arms.items()}
        self.pairs = Pairs(self.executors)
        self._eyes: Drawn | None = None

    def truth(self) -> dict[str, Any]:
        """What facts can be judged by (`tests.campaigns.against_truth`)."""
        sim, threads = self.sim, {thing.name: thing.thread for thing in self._cell.objects if thing.thread}
        turns = {name: (sim.bolts.out_turns(name), thread.turns) for name, thread in threads.items()}  # type: ignore[attr-defined]
        return {**sim.truth(), "held": sim.held(), "turns": turns}

    @property
    def eyes(self) -> Drawn:  # type: ignore[override]
        self._eyes = self._eyes or Drawn(self._cell)
        return self._eyes

    def close_eyes(self) -> None:
        """The next look opens them again."""
        if self._eyes is not None:
            self._eyes.studio.close()
            self._eyes = None

    def close(self) -> None:
        self.close_eyes()
        self.sim.close()  # type: ignore[attr-defined]


@dataclass
class Run:
    """How one command went."""

    script: Script | None = None
    refusal: Refusal | None = None
    labels: list[str] = field(default_factory=list)  # of the steps bound, in order
    primitives: list[Primitive] = field(default_factory=list)
    assessments: list[Assessment] = field(default_factory=list)
    reports: list[EndReport] = field(default_factory=list)
    trims: list[int] = field(default_factory=list)
    failure: Assessment | None = None  # the one that nothing has mended

    @property
    def succeeded(self) -> bool:
        return self.refusal is None and self.failure is None and all(a.verdict != "abort" for a in self.assessments)

    @property
    def reasons(self) -> list[str]:
        return [a.reason.value for a in self.assessments]


@lru_cache(maxsize=64)
def compiled(worker: ModuleType, program: bytes) -> Any:
    """As a worker does it: a program is compiled once."""
    return worker.compile(program)


class Bench:
    """Executes sentences by the loop of the paper, on one subsystem and one world."""

    def __init__(self, subsystem: Any, model: CellModel = MODEL) -> None:
        self.subsystem = subsystem
        self.model = model
        # As if the cell had been surveyed: a grasp is that of Figure 4 then. See `unsurveyed`.
        surveyed = [msgspec.structs.replace(change, spread=None) for change in initial_facts(model.cell)]
        self.world = World().overlay(surveyed)
        self.programs = {kind: loader.default(kind) for kind in ("parser", "elaborator", "binder", "analyzer")}
        self.commands = 0
        self.now_s = 0.0  # of the broker
        self.saved: SavedWorld | None = None  # facts of a file that come with each sentence
        self.moving: list[Primitive] = []  # of other arms
        self.rigid: list[str] = []  # exact arms

    def unsurveyed(self) -> None:
        """Things may be as far from where they are believed to be as the cell file says."""
        self.world = World().overlay(initial_facts(self.model.cell))

    def without_cameras(self) -> None:
        """The same cell without cameras: what is not known stays unknown."""
        self.model = SIGHTLESS

    def load(self, kind: str, text: str, name: str = "test.yaml") -> None:
        self.programs[kind] = loader.merge(kind, self.programs[kind], name, text.encode())

    def set_fact(self, key: str, value: Any, validity: Validity = Validity.VALID) -> None:
        self.world = self.world.overlay([WorldChange(key=key, value=value, validity=validity)])

    def elaborate(self, sentence: str, model: CellModel | None = None) -> Script | Refusal:
        self.commands += 1
        parsed = record(sentence, self.programs["parser"].decode())
        data = ElaboratorInput(
            command=f"C-{self.commands}",
            parsed=parsed,
            saved=self.saved,
            moving=self.moving,
            rigid=self.rigid,
        )
        return elaborator.run(compiled(elaborator, self.programs["elaborator"]), model or self.model, self.world, data)

    def bind(self, script: Script, step: Step, bindings: dict[str, Binding] | None = None, n: int = 1) -> Any:
        given = script.bindings if bindings is None else bindings
        name = f"C-{self.commands}.{n}"
        return self._bind(BinderInput(primitive_id=name, context=script.context, step=step, bindings=given))

    def bind_after(self, script: Script, step: Step, moved_s: float) -> Any:
        """As `bind`, after motions of the same command."""
        name = f"C-{self.commands}.2"
        given = {"context": script.context, "step": step, "bindings": script.bindings}
        return self._bind(BinderInput(primitive_id=name, moved_s=moved_s, **given))

    def _bind(self, data: BinderInput) -> Any:
        return binder.run(compiled(binder, self.programs["binder"]), self.model, self.world, data)

    def analyze(self, bound: BoundStep, report: EndReport, used: list[int] | None = None, closing: bool = False) -> Any:
        assert bound.evaluation is not None
        return self._analyze(
            AnalyzerInput(evaluation=bound.evaluation, report=report, trims_used=used or [], closing=closing)
        )

    def _analyze(self, data: AnalyzerInput) -> Any:
        return analyzer.run(compiled(analyzer, self.programs["analyzer"]), self.model, self.world, data)

    def do(self, sentence: str) -> Run:
        """The loop "WHILE Action_Stack Not_Empty" of the paper, section 4."""
        run = Run()
        script = self.elaborate(sentence)
        if isinstance(script, Refusal):
            run.refusal = script
            return run
        run.script = script
        actions = action_stack.begin(script)
        while actions.refs:
            actions.pop()
            name = f"C-{self.commands}.{len(run.labels) + 1}"
            run.labels.append(actions.step_body.label)
            bound = self._bind(actions.binder_input(name))
            if isinstance(bound, Refusal):
                run.refusal = bound
                return run
            actions.assign(bound.bindings)
            report = bound.report
            if bound.primitive is not None:
                run.primitives.append(bound.primitive)
                report = self.subsystem.perform(bound.primitive, bound)
            if report is None:
                continue
            run.reports.append(report)
            actions.moved_s += report.duration_s
            judged = self._analyze(actions.analyzer_input(bound.evaluation, report))
            if isinstance(judged, Refusal):
                run.refusal = judged
                return run
            assert isinstance(judged, Assessment), judged
            run.assessments.append(judged)
            self.world = self.world.overlay(judged.changes, f"C-{self.commands}/{len(run.assessments)}", self.now_s)
            actions.assign(judged.keep)
            trim = actions.push_trim(judged.trim, judged.further) if judged.verdict == "trim" else None
            if judged.verdict != "continue" and (trim is None or trim.then == "give_up"):
                run.failure = run.failure or judged
            if trim is not None:
                run.trims += [judged.trim, *judged.further]
            elif judged.verdict != "continue":
                return run
        return run


@pytest.fixture
def bench() -> Bench:
    """On perfect reports: pure."""
    return Bench(Reporter())


@pytest.fixture(params=["reports", pytest.param("kinematic", marks=pytest.mark.physics)])
def either(request: pytest.FixtureRequest) -> Bench:
    """The same on perfect reports, and on the MCM's own executor."""
    make: dict[str, Callable[[], Any]] = {"reports": Reporter, "kinematic": Kinematic}
    return Bench(make[request.param]())


@pytest.fixture
def physical() -> Iterator[Bench]:
    """In physics, without sockets: some six times slower than real time lasts."""
    subsystem = Physical()
    yield Bench(subsystem)
    subsystem.close()


@pytest.fixture
def parse() -> Callable[[str], ParsedCommand]:
    return record
