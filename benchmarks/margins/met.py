"""What the thresholds of a step met: the most extreme value of each condition of F, and what the end is judged by."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import msgspec

from benchmarks.copies import in_copies
from rtc.model.cells.cell import Cell
from rtc.protocol import primitive as p
from rtc.protocol.messages import ArmStep, BoundStep, EndReport, LookStep
from rtc.protocol.outcomes import StopReason
from rtc.sensing import rest
from rtc.spatial import geometry
from rtc.subsystems.motion.executor import Executor
from rtc.subsystems.motion.goals import LEANING_RAD
from rtc.subsystems.motion.modes import Mode
from sim_mcm.arms import detents
from sim_mcm.arms.bullet_world import PhysicsWorld
from tests.workers.conftest import Physical
from tests.workers.eyes import Drawn


class Met(NamedTuple):
    """One threshold in one step."""

    row: str  # what is compared, with the stop class or the kind of step
    limit: float
    value: float  # nearest to the limit, or beyond it
    ended: bool = False  # it has ended the step, or condemned its end
    label: str = ""  # of the step

    @property
    def share(self) -> float:
        return self.value / self.limit if self.limit else math.inf


Value = Callable[[Executor], float]
FALLEN_TICKS = 20  # for which a torque must have fallen


def _force(when: Any) -> Value:
    return _part(when.axis, slice(0, 3))


def _torque(when: Any) -> Value:
    return _part(when.axis, slice(3, 6))


def _part(axis: Any, of: slice) -> Value:
    if axis is None:
        return lambda arm: math.hypot(*arm.wrench[of])
    return lambda arm: sum(a * x for a, x in zip(axis, arm.wrench[of], strict=True))


def _behind(when: p.NoProgress) -> Value:
    """The distance behind the command, while the force is above its part of the condition."""

    def value(arm: Executor) -> float:
        if math.hypot(*arm.wrench[:3]) <= when.force_n:
            return 0.0
        tcp = arm.arm.tcp_pose
        return geometry.distance(tcp(arm.sample.joints), tcp(arm.command[0]))

    return value


class _Kind(NamedTuple):
    name: str
    value: Callable[[Any], Value]
    limit: Callable[[Any], float]
    below: bool = False  # the condition is true below its limit


#: conditions of F whose values are noted in each tick
KINDS: dict[type, _Kind] = {
    p.ForceAbove: _Kind("N", _force, lambda when: when.limit_n),
    p.TorqueAbove: _Kind("N.m", _torque, lambda when: when.limit_nm),
    p.NoProgress: _Kind("m behind", _behind, lambda when: when.behind_m),
    p.GripForceBelow: _Kind("N grip", lambda when: _weaker, lambda w: w.limit_n, True),
    p.HandWidthBelow: _Kind("m width", lambda when: lambda arm: sum(arm.sample.fingers), lambda w: w.limit_m, True),
    p.TorqueBelow: _Kind("N.m fallen", lambda when: _absolute(_torque(when)), lambda w: w.limit_nm, True),
    p.TimeAbove: _Kind("s", lambda when: lambda arm: 0.0, lambda w: w.limit_s),
}


def _weaker(arm: Executor) -> float:
    return min(arm.sample.finger_forces)


def _absolute(value: Value) -> Value:
    return lambda arm: abs(value(arm))


class _Extreme:
    """The most extreme value of one condition while its step executes."""

    def __init__(self, stop: p.StopFunction) -> None:
        kind = KINDS[type(stop.when)]
        self.stop, self.kind = stop, kind
        self.limit, self._value = kind.limit(stop.when), kind.value(stop.when)
        self.met: float | None = None
        self._latest: deque[float] = deque(maxlen=FALLEN_TICKS)
        self._armed = False

    def _lasting(self, value: float) -> float:
        """A torque that falls counts once it has been above, and if it lasts: the greatest of the latest ones."""
        self._armed = self._armed or value > self.limit
        self._latest.append(value if self._armed else math.inf)
        return max(self._latest)

    def see(self, arm: Executor) -> None:
        value = self._value(arm)
        if isinstance(self.stop.when, p.TorqueBelow):
            value = self._lasting(value)
        if self.met is None or (value < self.met if self.kind.below else value > self.met):
            self.met = value


class Watched(Physical):
    """Arms in physics whose steps are watched; `met` has what they met since it was emptied."""

    def __init__(self, cell: Any) -> None:
        super().__init__(cell)
        self.met: list[Met] = []
        self.without: tuple[type, ...] = ()  # conditions of F that are left out, to see what would be met
        self.noise, self.seed = 1.0, 1  # of the pictures
        self._extremes: list[_Extreme] = []
        self._arm: Executor | None = None

    @property
    def cell(self) -> Cell:
        return self._cell

    @property
    def world(self) -> PhysicsWorld:
        return self.sim.world  # type: ignore[attr-defined, no-any-return]

    @property
    def bullet_arms(self) -> list[Any]:
        return list(self.sim.arms.values())

    @property
    def eyes(self) -> Drawn:  # type: ignore[override]
        if self._eyes is None:
            cameras = [msgspec.structs.replace(one, noise=self.noise * one.noise) for one in self._cell.cameras]
            self._eyes = Drawn(msgspec.structs.replace(self._cell, cameras=cameras), self.seed)
        return self._eyes

    def perform(self, made: p.Primitive, bound: BoundStep) -> EndReport:
        look = isinstance(made.trajectory, p.Look)
        if bound.evaluation is not None and bound.evaluation.step.stop == "tug":
            self._before_tug(made, bound)
        self._extremes = [] if look else [_Extreme(stop) for stop in made.stop_functions if type(stop.when) in KINDS]
        self._arm = None if look else self.executors[made.performer]
        left = [stop for stop in made.stop_functions if not isinstance(stop.when, self.without)]
        report = super().perform(msgspec.structs.replace(made, stop_functions=left), bound)
        self._arm = None
        self.met += self._by_f(report, bound) + list(judged(made, report, bound))
        return report

    def _before_tug(self, made: p.Primitive, bound: BoundStep) -> None:
        """How the object stands in its seat; and, in copies, what the tug would feel if no touch ended it: with the
        object in its catch, and without."""
        assert bound.evaluation is not None
        context = bound.evaluation.context
        seat = self._cell.seat(context.target)
        true = geometry.compose(self.sim.truth()["seats"][seat.name], seat.module_frame.pose)
        there = self.world.pose(context.object)
        self.met.append(Met("catch: m off", detents.CATCHES_M, geometry.distance(true, there)))
        self.met.append(Met("catch: rad off", detents.CATCHES_RAD, geometry.angle(true, there)))
        self.met.append(Met("catch: caught", 0.5, float(context.object in self.sim._detents._caught)))  # type: ignore[attr-defined]
        for met in in_copies(lambda caught: self._tugged(made, bound, caught), (True, False)):
            self.met += met

    def _tugged(self, made: p.Primitive, bound: BoundStep, caught: bool) -> list[Met]:
        if not caught:
            self.sim._detents.let_go_all()  # type: ignore[attr-defined]
            self.sim._detents.look = lambda: None  # type: ignore[attr-defined]
        stops = [stop for stop in made.stop_functions if stop.reason is StopReason.CONTACT]
        self._extremes, self._arm = [_Extreme(stop) for stop in stops], self.executors[made.performer]
        others = [stop for stop in made.stop_functions if stop not in stops]
        super().perform(msgspec.structs.replace(made, stop_functions=others), bound)
        how = "caught" if caught else "free"
        return [Met(f"tug, {how}: {one.kind.name}", one.limit, one.met or 0.0) for one in self._extremes]

    def tick(self, now_s: float = 0.0) -> list[Any]:
        messages = super().tick(now_s)
        if (arm := self._arm) is not None and arm.state is Mode.EXECUTING:
            for extreme in self._extremes:
                extreme.see(arm)
        return messages

    def _by_f(self, report: EndReport, bound: BoundStep) -> list[Met]:
        assert bound.evaluation is not None
        evaluation, step = bound.evaluation, bound.evaluation.step
        place = step.stop or f"{step.do}-{step.op or step.name}"
        found = [Met(f"{place}: peak N", evaluation.force_n, report.peak_force_n, label=step.label)]
        for one in self._extremes:
            ended = report.reason is one.stop.reason and report.limit == one.limit
            value = report.measured if ended and report.measured is not None else one.met
            if isinstance(one.stop.when, p.TimeAbove):
                value = report.duration_s
            if value is not None:
                row = f"{place}: {one.stop.reason.value} {one.kind.name}"
                found.append(Met(row, one.limit, value, ended, step.label))
        return found


def judged(made: p.Primitive, report: EndReport, bound: BoundStep) -> list[Met]:
    """What the end of a step is judged by."""
    assert bound.evaluation is not None
    evaluation, step = bound.evaluation, bound.evaluation.step
    found: list[Met] = []
    within_m = step.within_m if isinstance(step, ArmStep) else None
    if report.sighting is not None:
        if isinstance(step, LookStep) and step.at_rest:
            metres, radians = rest.speeds(report.sighting.velocity)
            found += [Met("look: m/s", rest.MOVES_M_S, metres), Met("look: rad/s", rest.MOVES_RAD_S, radians)]
        return [one._replace(label=step.label) for one in found]
    if report.reason.value == "goal" and report.measured is not None and report.limit:
        found.append(Met(f"goal of {type(made.trajectory).__name__} {report.limit:.3g}", report.limit, report.measured))
    if isinstance(made.trajectory, p.JointTrajectory) and report.reason.value in ("goal", "timeout"):
        off = max(abs(a - b) for a, b in zip(report.joints, made.trajectory.positions[-1], strict=True))
        found.append(Met(f"{step.stop}: joint off", LEANING_RAD, off))
    if evaluation.width_m is not None:
        least, most = evaluation.width_m
        found.append(Met(f"{step.do}-{step.op}: least width", least, report.hand_width_m, report.hand_width_m < least))
        if most < 1.0:
            found.append(Met(f"{step.do}-{step.op}: most width", most, report.hand_width_m, report.hand_width_m > most))
    if isinstance(made.trajectory, p.HandMotion) and step.op == "close":
        share = report.hand_force_n / made.trajectory.force_n if made.trajectory.force_n else 0.0
        found.append(Met("grip: share of the command", 1.0, share))
    if evaluation.goal_pose is not None and report.tcp_pose:
        off_m = geometry.distance(report.tcp_pose, evaluation.goal_pose)
        if within_m is not None:
            found.append(Met(f"{step.stop}: m within", within_m, off_m, off_m > within_m))
        elif report.reason.value == "goal":
            turned = geometry.angle(report.tcp_pose, evaluation.goal_pose)
            found += [Met(f"{step.stop}: m off", 0.003, off_m), Met(f"{step.stop}: rad off goal", 0.02, turned)]
    return [one._replace(label=step.label) for one in found]
