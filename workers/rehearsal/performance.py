"""One sentence performed on paper: the loop of the Decision Unit with predicted reports and an overlay of the world.

Pure. It calls the functions of elaborator, binder and analyzer in turn, and knows no skill.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from operator import lt
from typing import Any, NamedTuple

import msgspec

from rtc.programs import action_stack
from rtc.programs.action_stack import ActionStack
from rtc.protocol.messages import (
    Assessment,
    BoundStep,
    ElaboratorInput,
    EndReport,
    Fact,
    PictureTime,
    Script,
    WorkerKind,
)
from rtc.protocol.outcomes import Reflex, Refusal, RefusalReason, Refused, StopReason
from rtc.protocol.primitive import ForceAbove, HandMotion, HoldStill, JointTrajectory, Look, Primitive, SpindleMotion
from rtc.protocol.rehearsal import RehearsedStep
from rtc.protocol.sentence import ParsedCommand
from rtc.world.spread import EXACT, Spread, widened
from workers.analyzer import analyze
from workers.binder import bind
from workers.elaborator import elaborate
from workers.planning import pose_spread
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery
from workers.rehearsal.paper_world import PaperWorld
from workers.rehearsal.predicted_report import end_report

UNTIL_STOPPED_S = 600.0  # a rest or a look of this length without FOR lasts until a person ends it
MAX_STEPS = 200  # of one sentence: a limit of the loop, which trims make longer
# What a compliant hand bears where it comes to rest with an object on a hinge: it stretches its spring. It was at most
# 9.9 mm and 0.014 rad beside its goal, with 600 N/m and hinges of 1.0 and 1.5 N.m (n 9; docs/physics.md).
BEARS_N, BEARS_NM = 6.0, 0.27

Programs = Mapping[WorkerKind, Any]


class BoundPrimitive(NamedTuple):
    """A primitive was bound, and has not begun."""

    actions: ActionStack[Script, Any]
    world: PaperWorld
    now_s: float
    bound: BoundStep


@dataclass
class Performance:
    """A sentence on paper. `world` and `now_s` (the broker's clock) are those after the steps so far. `advise`: as of
    the elaborator; a repair that is refused is not shown. `rigid`, `pictures`: as in `RehearsalInput`."""

    programs: Programs
    model: CellModel
    world: PaperWorld
    now_s: float
    command: str
    advise: bool = True
    rigid: Collection[str] = ()
    pictures: Mapping[str, PictureTime] = field(default_factory=dict)
    script: Script | None = None
    actions: ActionStack[Script, Any] | None = None
    steps: list[RehearsedStep] = field(default_factory=list)
    moments: list[BoundPrimitive] = field(default_factory=list)
    assumes: list[str] = field(default_factory=list)
    refusal: Refusal | None = None
    given_up: Refusal | None = None
    remark: str = ""  # of the last step: what the result would state
    # Pose -> how far a camera or a touch may find it from where the paper has it: what was known before that.
    known_within: dict[str, Spread] = field(default_factory=dict)
    stretched: dict[str, Spread] = field(default_factory=dict)  # arm -> how far it may rest from where the paper has it

    @property
    def predicted_s(self) -> float:
        return sum(step.predicted_s for step in self.steps)

    @property
    def step(self) -> str:
        """The current step in words, as in `Outcome.step`; empty before the first."""
        if self.actions is None or self.actions.step is None:
            return ""
        trim, index = self.actions.step
        label = self.actions.step_body.label
        if trim == action_stack.NOMINAL:
            return f"{index + 1} of {len(self.actions.script.steps)}: {label}"
        return f"trim {trim}, {index + 1} of {len(self.actions.trim(trim).steps)}: {label}"

    def run(self, parsed: ParsedCommand) -> Performance:
        """Elaborate the sentence and perform its steps until the last, or until one is refused."""
        data = ElaboratorInput(command=self.command, parsed=parsed, rigid=[*self.rigid])
        try:
            program = self.programs[WorkerKind.ELABORATOR]
            self.script = _unless_refused(elaborate.run(program, self.model, self.world, data, advise=self.advise))
            self.actions = action_stack.begin(self.script)
            self.go_on()
        except Refused as refused:
            self.refusal = refused.refusal
        return self

    def go_on(self, left: int = 0) -> None:
        """Perform the steps that are on the stack, until this number is left. Raises Refused."""
        assert self.actions is not None
        while len(self.actions.refs) > left:
            if len(self.steps) > MAX_STEPS:
                raise Refused.because(RefusalReason.PROGRAM, f"the script does not end within {MAX_STEPS} steps")
            self.actions.pop()
            self._perform_step()
        if self.given_up is not None:
            raise Refused(self.given_up)

    def bind(self) -> BoundStep:
        """The current step, bound in the world on paper. Raises Refused."""
        assert self.actions is not None
        name = f"{self.command}.{len(self.steps) + 1}"
        data = msgspec.structs.replace(self.actions.binder_input(name), pictures=dict(self.pictures))
        bound: BoundStep = self._call(bind, WorkerKind.BINDER, data)
        self.actions.assign(bound.bindings)
        return bound

    def judge(self, bound: BoundStep, report: EndReport) -> Assessment:
        """The analyzer's verdict on a report; its changes are in the world on paper from now on. Raises Refused."""
        assert self.actions is not None
        self.now_s += report.duration_s
        self.actions.moved_s += report.duration_s
        data = self.actions.analyzer_input(bound.evaluation, report)
        judged: Assessment = self._call(analyze, WorkerKind.ANALYZER, data)
        before, self.world = (
            self.world,
            self.world.overlay(judged.changes, f"{self.command}/{len(self.steps)}", self.now_s),
        )
        self._note_measured(before.facts, judged)
        self.actions.assign(judged.keep)
        return judged

    def _note_measured(self, before: Mapping[str, Fact], judged: Assessment) -> None:
        """On paper a body is found where it is believed to be; in truth anywhere that was possible. What is brought
        into a seat is where the seat is found."""
        poses = [change for change in judged.changes if change.spread is not None and change.key.endswith(".frame")]
        measured: Spread | None = None
        for change in poses:
            fact = before.get(change.key)
            if fact is not None and fact.spread is not None and any(map(lt, change.spread or EXACT, fact.spread)):
                measured = measured or fact.spread
                self.known_within.setdefault(change.key, fact.spread)
        for change in poses:  # a seat that is found with its module
            if measured is not None and before.get(change.key) is None:
                self.known_within.setdefault(change.key, measured)
        for change in judged.changes:
            thing, _, attribute = change.key.partition(".")
            fact = before.get(change.key)
            if attribute == "seat" and change.value and (fact is None or fact.value != change.value):
                self.known_within[f"{thing}.frame"] = self.known_within.get(f"{change.value}.frame", EXACT)

    def spread_of(self, fact: Fact) -> list[float] | None:
        """How far the fact may be from what is predicted."""
        within = self.known_within.get(fact.key)
        spread = fact.spread if within is None else widened(fact.spread or EXACT, within)
        return widened(spread or EXACT, aside) if (aside := self._beside_hinge(fact)) is not None else spread

    def _beside_hinge(self, fact: Fact) -> list[float] | None:
        """How far a hand may be from where the paper has it, in the axes of a body that its hinge keeps in place; None
        for any other fact. Only the angle of such a body is unsure, but its place in the hand is as unsure as the hand.
        """
        thing, _, attribute = fact.key.rpartition(".")
        if attribute != "grasp" or fact.value is None or (query := self.query()).hinge(thing) is None:
            return None
        off = self.stretched.get(query.held_by(thing))
        return None if off is None else pose_spread.spread_at(off, fact.value)

    def follow(self, judged: Assessment) -> str:
        """Push the trim that the verdict asks for; what follows it. Raises Refused without one, with the failure."""
        assert self.actions is not None
        failure = Refusal(reason=RefusalReason.STATE, message=judged.message, clears=judged.clears)
        trim = self.actions.push_trim(judged.trim, judged.further) if judged.verdict == "trim" else None
        if trim is None:
            raise Refused(self.given_up or failure)
        if trim.then == "give_up":
            self.given_up = failure
        return trim.then

    def query(self) -> WorldQuery:
        return WorldQuery(self.model, self.world)

    def _perform_step(self) -> None:
        assert self.actions is not None
        bound = self.bind()
        report = bound.report
        if bound.primitive is not None:
            query = self.query()
            report = self._report(query, bound)
            if lasts_until_stopped(bound):
                report = msgspec.structs.replace(report, duration_s=0.0, at_s=self.now_s)
            self.assumes += assumptions(bound, report)
            self.steps.append(rehearsed(query, bound, report, self.actions.step[0] if self.actions.step else 0))
            self.moments.append(BoundPrimitive(copied(self.actions), self.world, self.now_s, bound))
        if report is None:
            return
        self._note_stretched(bound)
        judged = self.judge(bound, report)
        self.remark = judged.remark
        if judged.verdict != "continue":
            self.follow(judged)

    def _note_stretched(self, bound: BoundStep) -> None:
        """A compliant hand rests beside its goal by what it bears; one whose position is controlled rests there."""
        made = bound.primitive
        if made is None or not isinstance(made.trajectory, JointTrajectory):
            return
        self.stretched.pop(made.performer, None)
        if (soft := made.control_law.compliance) is not None:
            bears = [BEARS_N] * 3 + [BEARS_NM] * 3
            self.stretched[made.performer] = [
                most / firm if firm else 0.0 for most, firm in zip(bears, soft.stiffness, strict=True)
            ]

    def _report(self, query: WorldQuery, bound: BoundStep) -> EndReport:
        """The predicted one. An exact arm refuses what must give way, as it would in a motion (`KinematicArm`)."""
        made = bound.primitive
        assert made is not None
        turns = isinstance(made.trajectory, SpindleMotion)
        gives_way = made.control_law.compliance is not None
        gives_way |= any(stop.reflex is Reflex.COMPLY for stop in made.stop_functions)
        if made.performer not in self.rigid or not (turns or gives_way):
            return end_report(query, bound, self.now_s)
        what = "turns no bolts" if turns else "cannot comply"
        message = f"{made.performer} is exact and {what}; arms with physics do (rtc up --mcm bullet)"
        refused = end_report(query, bound, self.now_s, StopReason.REFUSED)
        return msgspec.structs.replace(refused, message=message, duration_s=0.0)

    def _call(self, function: Any, kind: WorkerKind, data: Any) -> Any:
        return _unless_refused(function.run(self.programs[kind], self.model, self.world, data))


def _unless_refused(product: Any) -> Any:
    if isinstance(product, Refusal):
        raise Refused(product)
    return product


def copied(actions: ActionStack[Script, Any]) -> ActionStack[Script, Any]:
    """The stack as it is now; performing either does not change the other."""
    return msgspec.structs.replace(
        actions,
        refs=list(actions.refs),
        trims_used={step: list(used) for step, used in actions.trims_used.items()},
    )


def lasts_until_stopped(bound: BoundStep) -> bool:
    """Whether only a halt or an ABORT ends the step in practice: it rests or looks without FOR."""
    made = bound.primitive
    assert made is not None
    trajectory = made.trajectory
    duration_s = trajectory.duration_s if isinstance(trajectory, HoldStill | Look) else 0.0
    return (duration_s is None and isinstance(trajectory, HoldStill)) or (duration_s or 0.0) >= UNTIL_STOPPED_S


def rehearsed(query: WorldQuery, bound: BoundStep, report: EndReport, trim: int) -> RehearsedStep:
    """What the answer states of a step."""
    made, evaluation = bound.primitive, bound.evaluation
    assert made is not None
    assert evaluation is not None
    moves = isinstance(made.trajectory, JointTrajectory)
    load = query.load(made.performer) if moves else None
    return RehearsedStep(
        label=evaluation.step.label,
        performer=made.performer,
        reason=report.reason.value,
        predicted_s=report.duration_s,
        until_stopped=lasts_until_stopped(bound),
        tcp_pose=report.tcp_pose,
        carried_kg=load.mass_kg if load else None,
        grip_n=made.trajectory.force_n if isinstance(made.trajectory, HandMotion) and report.hand_force_n else None,
        press_n=pressed_n(made),
        stops_at_n=min(
            (one.when.limit_n for one in made.stop_functions if isinstance(one.when, ForceAbove)), default=None
        ),
        note=bound.note,
        trim=trim,
    )


def pressed_n(made: Primitive) -> float | None:
    """The greatest force set-point of a compliant motion."""
    compliance = made.control_law.compliance
    return max((abs(force) for force in (compliance.wrench if compliance else [])[:3] if force), default=None)


def assumptions(bound: BoundStep, report: EndReport) -> list[str]:
    """What the step takes for granted, because only sensing can tell."""
    assert bound.evaluation is not None
    label = bound.evaluation.step.label
    if report.sighting is not None:
        return [f"{label}: {bound.evaluation.body} is seen where it is believed to be"]
    if report.reason is StopReason.OPERATOR_DONE:
        return [f"{label.removeprefix('OPERATOR: ')}: the operator does it; the time is not counted"]
    if report.reason is StopReason.CONTACT:
        return [f"{label}: the touch is felt where it is expected"]
    return []
