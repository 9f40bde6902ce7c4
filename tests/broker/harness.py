"""A Decision Unit under test: feed it events in few words, read its effects as short lines, in order.

`brief` keeps what an effect does and to whom; times and opaque bytes are left out. Tests compare whole lists of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec

from broker.decisions import effects as do
from broker.decisions import events
from broker.decisions.decide import decide
from broker.decisions.state import State
from rtc.protocol import wire
from rtc.protocol.messages import (
    Assessment,
    Binding,
    BoundStep,
    EndReport,
    EvaluationContext,
    Paper,
    Rehearsed,
    Script,
    ScriptContext,
    TellStep,
    Trim,
)
from rtc.protocol.outcomes import Refusal, RefusalReason, StopReason
from rtc.protocol.primitive import Box, GoalReached, HoldStill, JointTrajectory, Primitive, StopFunction, TimeAbove
from rtc.protocol.rehearsal import Rehearsal
from rtc.protocol.sentence import ParsedCommand
from tests.broker.flat_events import made

CONTEXT = ScriptContext(verb="GRASP", script="test", arm="RIGHT-ARM", object="MODULE")
F = [
    StopFunction(reason=StopReason.GOAL, when=GoalReached()),
    StopFunction(reason=StopReason.TIMEOUT, when=TimeAbove(5.0)),
]

STILL = [[0.0], [0.0]]
PATH = JointTrajectory(
    space="joint", time_s=[0.0, 1.0], positions=[[0.0], [1.0]], velocities=STILL, accelerations=STILL
)


def brief(effect: do.Effect) -> str:
    match effect:
        case do.DispatchJob():
            lease = f" lease {'+'.join(effect.locations)}" if effect.locations is not None else ""
            lease += " doubt" if effect.doubt else ""
            return f"job {effect.job} {effect.queue} #{effect.attempt}{lease}"
        case do.CancelJob():
            return f"cancel {effect.job}"
        case do.SendPrimitive():
            return f"primitive {effect.id} to {effect.subsystem}"
        case do.SendPace():
            return f"{'pause' if effect.paused else 'go on'} {effect.primitive} at {effect.subsystem}"
        case do.SendAnswer():
            return f"{'done' if effect.answer.done else 'cannot'} {effect.answer.primitive} to {effect.subsystem}"
        case do.SendHalt():
            return f"halt {effect.order.scope} to {effect.subsystem}"
        case do.AcknowledgeReport():
            return f"ack {effect.primitive}"
        case do.StartTimer():
            return f"timer {effect.timer}"
        case do.StopTimer():
            return f"no timer {effect.timer}"
        case do.TellClient():
            message = effect.message
            return f"tell {effect.client} {'CommandEnded' if isinstance(message, msgspec.Raw) else _in_words(message)}"
        case do.PublishNote():
            return f"note {effect.note.command} {effect.note.phase.value}"
        case do.ReportEnd():
            return f"end {effect.ended.command} {effect.ended.outcome.kind.value}"
        case do.DeclineHalt():
            return f"decline halt {effect.halt}"
        case do.PublishHalt():
            return f"publish halt {effect.halt.halt} {effect.halt.scope}"
    raise AssertionError(effect)


def _in_words(message: Any) -> str:
    return type(message).__name__ + (f" {message.command}" if hasattr(message, "command") else "")


class Harness:
    """One Decision Unit, its time, and everything it wanted done."""

    def __init__(self, *, mcm: bool = True) -> None:
        self.state = State()
        self.now = 0.0
        self.log: list[do.Effect] = []
        if mcm:
            self.mcm_hello()

    def handle(self, what: type[events.Event], /, **fields: Any) -> list[str]:
        self.now += 0.001
        effects = decide(self.state, self.event(what, **fields))
        self.log += effects
        return [brief(e) for e in effects]

    def event(self, what: type[events.Event], /, **fields: Any) -> events.Event:
        """An event of now; a confirmed halt without `performers` is for all of its subsystem."""
        if what is events.HaltConfirmed:
            known = self.state.subsystems.get(fields["subsystem"])
            fields.setdefault("performers", known.performers if known else [])
        return made(what, self.now, **fields)

    # --- who speaks ---

    def mcm_hello(
        self, pid: int = 1, outstanding: list[str] | None = None, at_rest: bool = True, **more: Any
    ) -> list[str]:
        return self.handle(
            events.SubsystemConnected,
            subsystem="MCM",
            pid=pid,
            performers=["LEFT-ARM", "RIGHT-ARM"],
            outstanding=outstanding or [],
            at_rest=at_rest,
            **more,
        )

    def says(self, text: str, client: str = "ann", request: str = "", **fields: Any) -> list[str]:
        request = request or f"r{self.state.accepted + 1}"
        return self.handle(events.CommandReceived, client=client, request=request, text=text, **fields)

    def answers(self, command: str, product: Any, attempt: int | None = None, job: str = "") -> list[str]:
        """The worker of this command's pending job delivers."""
        pending = self.state.commands[command].job if command in self.state.commands else None
        return self.handle(
            events.JobFinished,
            job=job or pending.id,
            attempt=attempt or (pending.attempt if pending else 1),
            node="worker",
            product=wire.raw(product),
        )

    def declines(self, command: str, reason: RefusalReason = RefusalReason.INFEASIBLE) -> list[str]:
        job = self.state.commands[command].job
        refusal = Refusal(reason=reason, message="no")
        return self.handle(events.JobDeclined, job=job.id, attempt=job.attempt, node="worker", refusal=refusal)

    def is_blocked(self, command: str, arm: str) -> list[str]:
        """The planner of this command's pending job finds another arm in its way."""
        job = self.state.commands[command].job
        refusal = in_the_way(arm)
        return self.handle(events.JobDeclined, job=job.id, attempt=job.attempt, node="worker", refusal=refusal)

    def loses_worker(self, command: str, blamed: bool = True) -> list[str]:
        job = self.state.commands[command].job
        return self.handle(
            events.JobLost, job=job.id, attempt=job.attempt, node="worker", evidence="exit -9", blamed=blamed
        )

    def tells(self, command: str, how: str = "done") -> list[str]:
        """The worker that has the last analysis of a command that has ended: it is "done", finds the world "away", or
        it "dies"."""
        job = self.state.deferred_analyses[command].job
        about = {"job": job.id, "attempt": job.attempt, "node": "worker"}
        match how:
            case "away":
                refusal = Refusal(reason=RefusalReason.TIMEOUT, message="no")
                return self.handle(events.JobDeclined, refusal=refusal, **about)
            case "dies":
                return self.handle(events.JobLost, evidence="exit -9", **about)
        return self.handle(events.JobFinished, product=wire.raw(go_on()), **about)

    def reports(
        self, command: str, reason: StopReason = StopReason.GOAL, primitive: str = "", duration_s: float = 1.0
    ) -> list[str]:
        live = self.state.commands.get(command)
        ended = report(primitive or live.primitive, reason, duration_s=duration_s)
        return self.handle(events.PrimitiveEnded, subsystem="MCM", report=ended)

    def halts(self, scope: str = "ALL", halt: str = "h1") -> list[str]:
        return self.handle(events.HaltCalled, client="ann", halt=halt, scope=scope)

    def rests(self, halt: str, at_rest: bool = True) -> list[str]:
        return self.handle(events.HaltConfirmed, subsystem="MCM", halt=halt, at_rest=at_rest)

    def rings(self, command: str) -> list[str]:
        if live := self.state.commands.get(command):
            self.now = max(self.now, live.due_s)
        return self.handle(events.TimerFired, timer=command)

    def mcm_gone(self) -> list[str]:
        return self.handle(events.SubsystemGone, subsystem="MCM", why="killed")

    # --- shortcuts to a phase ---

    def tested(self, text: str = "TEST X", after: str = "", parsed: Any = None, **about: Any) -> str:
        """A TEST sentence to its end; returns the digest. `parsed`: the record of the sentence without TEST."""
        self.says(text, after_test=after)
        command = f"C-{self.state.accepted}"
        self.answers(command, msgspec.structs.replace(parsed or record(), test=True))
        self.answers(command, rehearsed(parsed or record(), **about))
        return str(self.outcome(command).rehearsal.digest)

    def parsed(self, text: str = "", **head: Any) -> str:
        """A new command, parsed; returns its number. Without a text its sentence is one of its own."""
        self.says(text or f"X {self.state.accepted + 1}")
        command = f"C-{self.state.accepted}"
        self.answers(command, record(**head))
        return command

    def elaborated(self, script_: Script | None = None, **head: Any) -> str:
        command = self.parsed(**head)
        self.answers(command, script_ or script())
        return command

    def executing(self, script_: Script | None = None, **head: Any) -> str:
        command = self.elaborated(script_, **head)
        arm = next((r for r in (script_.resources if script_ else ()) if r.endswith("ARM")), "RIGHT-ARM")
        self.answers(command, bound(f"{command}.1", arm))
        return command

    def analyzing(self, script_: Script | None = None, reason: StopReason = StopReason.GOAL) -> str:
        command = self.executing(script_)
        self.reports(command, reason)
        return command

    def phase(self, command: str) -> str:
        live = self.state.commands.get(command)
        return live.phase.value if live else "gone"

    def outcome(self, command: str) -> Any:
        return next(e.ended.outcome for e in self.log if isinstance(e, do.ReportEnd) and e.ended.command == command)


def in_the_way(arm: str) -> Refusal:
    return Refusal(reason=RefusalReason.INFEASIBLE, message=f"{arm} is in the way", in_the_way=arm)


def record(kind: str = "task", verb: str = "GRASP", **fields: Any) -> ParsedCommand:
    fields.setdefault("hand", "RIGHT-ARM" if kind == "task" else None)
    return ParsedCommand(kind=kind, verb=verb, **fields)  # type: ignore[arg-type]


def script(
    steps: int = 1,
    resources: tuple[str, ...] = ("RIGHT-ARM",),
    trims: list[Trim] | None = None,
    writes: tuple[str, ...] | None = None,
) -> Script:
    return Script(
        context=CONTEXT,
        case=3,
        steps=[TellStep(label=f"step {n}") for n in range(1, steps + 1)],
        trims=trims or [],
        bindings={"JAP": Binding(number=1.0)},
        resources=list(resources),
        writes=list(resources if writes is None else writes),
    )


def trim(n: int = 1, then: Any = "retry_step", steps: int = 1) -> Trim:
    return Trim(n=n, label=f"trim {n}", then=then, steps=[TellStep(label="mend") for _ in range(steps)])


def bound(primitive: str, performer: str = "RIGHT-ARM", *, moves: bool = False, space: Sequence[Box] = ()) -> BoundStep:
    """`moves`: the arm leaves its place."""
    path = PATH if moves else HoldStill()
    body = Primitive(id=primitive, performer=performer, trajectory=path, stop_functions=F, space_mm=list(space))
    evaluation = EvaluationContext(context=CONTEXT, step=TellStep(label="x"), arm=performer)
    return BoundStep(subsystem="MCM", primitive=body, evaluation=evaluation, limit_s=5.0)


def stated(value: float = 2.1) -> BoundStep:
    """Facts stated by the operator: a report without a subsystem."""
    facts_report = msgspec.structs.replace(
        report("C-1.1", performer="OPERATOR"), joints=[], facts={"MODULE.mass": value}
    )
    evaluation = EvaluationContext(context=CONTEXT, step=TellStep(label="x"))
    return BoundStep(report=facts_report, evaluation=evaluation, note="stated")


def report(
    primitive: str, reason: StopReason = StopReason.GOAL, performer: str = "RIGHT-ARM", duration_s: float = 1.0
) -> EndReport:
    return EndReport(
        primitive=primitive,
        performer=performer,
        reason=reason,
        at_s=0.0,
        duration_s=duration_s,
        joints=[0.0] * 6,
        tcp_pose=[0, 0, 0, 0, 0, 0, 1],
        wrench=[0.0] * 6,
        hand_width_m=0.08,
        hand_force_n=0.0,
    )


def rehearsed(parsed: ParsedCommand, refusal: Refusal | None = None, **about: Any) -> Rehearsed:
    """The product of a rehearser; `about`: fields of the rehearsal."""
    rehearsal = Rehearsal(predicted_s=2.0, resources=["RIGHT-ARM"], **about)
    return Rehearsed(rehearsal=rehearsal, parsed=parsed, after=Paper(at_s=2.0), refusal=refusal)


def go_on(reason: StopReason = StopReason.GOAL) -> Assessment:
    return Assessment(verdict="continue", reason=reason)


def mend(n: int = 1, reason: StopReason = StopReason.NO_CONTACT) -> Assessment:
    return Assessment(verdict="trim", reason=reason, trim=n, message="nothing felt")


def give_up(reason: StopReason = StopReason.FORCE_LIMIT) -> Assessment:
    return Assessment(verdict="abort", reason=reason, message="too much force")
