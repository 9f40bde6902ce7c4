"""Four trivial worker functions: a sentence of two words becomes one step, one primitive and one success.

They have the interface of the real functions and run in the real worker loop. Pure, except for `busy` and `asleep`.

    MOVE LOAD-17    moves the performer LOAD-17, which is reserved from the plan to the end; writes nothing to the world

The subsystem has PERFORMERS of them, so that many commands run at once without waiting.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

from rtc.protocol.messages import (
    AnalyzerInput,
    Assessment,
    BinderInput,
    BoundStep,
    ElaboratorInput,
    EvaluationContext,
    ParserInput,
    Script,
    ScriptContext,
    TellStep,
    WorkerKind,
)
from rtc.protocol.outcomes import Refusal, RefusalReason, StopReason
from rtc.protocol.primitive import GoalReached, HoldStill, Primitive, StopFunction, TimeAbove
from rtc.protocol.sentence import ParsedCommand

SUBSYSTEM = "MCM"
PERFORMERS = 2048
LIMIT_S = 5.0  # time limit of the primitive

STEP = TellStep(label="stay where it is")
F = [
    StopFunction(reason=StopReason.GOAL, when=GoalReached()),
    StopFunction(reason=StopReason.TIMEOUT, when=TimeAbove(limit_s=LIMIT_S)),
]


def sentence(n: int) -> str:
    """The n-th sentence; PERFORMERS consecutive ones need different performers."""
    return f"MOVE {performer(n % PERFORMERS)}"


def performer(n: int) -> str:
    return f"LOAD-{n}"


def parse(data: ParserInput) -> ParsedCommand | Refusal:
    words = data.text.split()
    if len(words) != 2:
        return Refusal(reason=RefusalReason.SENTENCE, message="a sentence has two words: MOVE LOAD-n")
    return ParsedCommand(kind="task", verb=words[0], hand=words[1])


def elaborate(data: ElaboratorInput) -> Script:
    hand = data.parsed.hand or ""
    context = ScriptContext(verb=data.parsed.verb, script="trivial", arm=hand)
    return Script(context=context, case=1, steps=[STEP], resources=[hand])


def bind(data: BinderInput) -> BoundStep:
    primitive = Primitive(
        id=data.primitive_id, performer=data.context.arm, trajectory=HoldStill(duration_s=0.0), stop_functions=F
    )
    evaluation = EvaluationContext(context=data.context, step=data.step, arm=data.context.arm)
    return BoundStep(subsystem=SUBSYSTEM, primitive=primitive, evaluation=evaluation, limit_s=LIMIT_S)


def analyze(data: AnalyzerInput) -> Assessment:
    expected = data.report.reason in data.evaluation.step.expect
    return Assessment(verdict="continue" if expected else "abort", reason=data.report.reason)


def busy(body: Callable[[Any], Any], for_s: float) -> Callable[[Any], Any]:
    """The same function, after this much work."""

    def work(data: Any) -> Any:
        until_s = time.perf_counter() + for_s
        while time.perf_counter() < until_s:
            pass
        return body(data)

    return work


def asleep(body: Callable[[Any], Any], for_s: float) -> Callable[[Any], Any]:
    """The same function after this much sleep: a job that takes time but no processor."""

    def work(data: Any) -> Any:
        time.sleep(for_s)
        return body(data)

    return work


class Function(NamedTuple):
    """The interface of a worker module, as the worker loop requires it."""

    INPUT: Any
    body: Callable[[Any], Any]
    NEEDS_WORLD: bool = False
    NEEDS_CELL: bool = False

    def compile(self, program: bytes) -> bytes:
        return program

    def run(self, compiled: Any, cell: Any, world: Any, data: Any) -> Any:
        return self.body(data)


FUNCTIONS = {
    WorkerKind.PARSER: Function(ParserInput, parse),
    WorkerKind.ELABORATOR: Function(ElaboratorInput, elaborate),
    WorkerKind.BINDER: Function(BinderInput, bind),
    WorkerKind.ANALYZER: Function(AnalyzerInput, analyze),
}
