"""Worker functions for the simulated cluster: plain, deterministic, and quick. A sentence is its own program.

DO ARM STEP STEP ... [AFTER C-n] [TOGETHER-WITH C-n] [NOW]      a STEP is one of STEPS
TEST DO ... on paper
NO          refused by the parser          STUCK     refused by the elaborator
POISON      kills every parser that reads it
HALT, HALT ARM, HALT C-n, ABORT C-n        as in the language
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import msgspec

from rtc.protocol import wire
from rtc.protocol.messages import (
    AnalyzerInput,
    Assessment,
    BinderInput,
    BoundStep,
    ElaboratorInput,
    EvaluationContext,
    Paper,
    ParserInput,
    RehearsalInput,
    Rehearsed,
    Script,
    ScriptContext,
    TellStep,
    Trim,
    Validity,
    WorldChange,
)
from rtc.protocol.outcomes import Refusal, RefusalReason, StopReason
from rtc.protocol.primitive import (
    Box,
    GoalReached,
    HoldStill,
    JointTrajectory,
    Primitive,
    StartAfter,
    StopFunction,
    TimeAbove,
    Trajectory,
)
from rtc.protocol.primitive_id import command_of
from rtc.protocol.rehearsal import Rehearsal
from rtc.protocol.sentence import ParsedCommand

ARMS = {"LEFT": "LEFT-ARM", "RIGHT": "RIGHT-ARM"}
STEPS = ("swing", "hold", "let", "late", "late-mended", "late-skipped")
LIMIT_S = 3.0  # for an end report
SWING_RAD = 0.004  # so little that a swing may begin wherever another was stopped
STILL = [[0.0, 0.0]] * 3
SWING = JointTrajectory(
    space="joint",
    time_s=[0.0, 0.012, 0.024],
    positions=[[0.0, 0.0], [SWING_RAD, -SWING_RAD], [0.0, 0.0]],
    velocities=STILL,
    accelerations=STILL,
)
MOTIONS: dict[str, Trajectory] = {
    "swing": SWING,
    "hold": HoldStill(duration_s=0.008),
    "late": HoldStill(),  # only its time limit ends it: nothing can mend that,
    "late-mended": HoldStill(),  # or a trim can,
    "late-skipped": HoldStill(),  # or it is expected
}
#: of the motions of a command, by its number: two are apart, one meets both, one is not known
SPACES: list[list[Box]] = [[(0, 0, 0, 9, 9, 9)], [(20, 0, 0, 29, 9, 9)], [(5, 0, 0, 25, 9, 9)], []]
TIME_S = 0.015  # the limit of what has no end of its own
read_parsed = wire.decoder(ElaboratorInput)
read_step = wire.decoder(BinderInput)
read_report = wire.decoder(AnalyzerInput)
read_text = wire.decoder(ParserInput)
read_rehearsal = wire.decoder(RehearsalInput)


class Kill(Exception):
    """The worker dies of it."""


def no(reason: RefusalReason, message: str) -> Refusal:
    return Refusal(reason=reason, message=message)


def parse(data: bytes) -> ParsedCommand | Refusal:
    words = read_text(data).text.split()
    test = words[0] == "TEST"
    words = words[test:]
    named = dict(pairwise(words))
    match words[0]:
        case "POISON":
            raise Kill
        case "NO":
            return no(RefusalReason.SENTENCE, "no sentence")
        case "ABORT":
            return ParsedCommand(kind="control", verb="ABORT", object=words[1])
    return ParsedCommand(
        kind="task",
        verb=words[0],
        test=test,
        hand=ARMS.get(words[1]) if len(words) > 1 else None,
        after=named.get("AFTER"),
        together_with=named.get("TOGETHER-WITH"),
        now="NOW" in words,
        reason=" ".join(words),
    )


def elaborate(data: bytes) -> Script | Refusal:
    text = read_parsed(data).parsed.reason or ""
    return no(RefusalReason.NO_SCRIPT, "stuck") if text.startswith("STUCK") else script_of(text)


@cache
def script_of(text: str) -> Script:
    words = text.split()
    arm = ARMS[words[1]]
    steps = [TellStep(label=word) for word in words[2:] if word in STEPS]
    return Script(
        context=ScriptContext(verb="DO", script=text, arm=arm),
        case=1,
        steps=steps,
        trims=[Trim(n=1, label="hold instead", steps=[TellStep(label="hold")], then="skip")],
        resources=[arm],
        writes=[arm],
    )


def bind(data: bytes) -> BoundStep | Refusal:
    asked = read_step(data)
    arm, step = asked.context.arm, asked.step
    if step.label == "let":
        return BoundStep(note="stated, not done")
    stops = [
        StopFunction(reason=StopReason.GOAL, when=GoalReached()),
        StopFunction(reason=StopReason.TIMEOUT, when=TimeAbove(TIME_S if step.label.startswith("late") else 5.0)),
    ]
    primitive = Primitive(
        id=asked.primitive_id,
        performer=arm,
        trajectory=MOTIONS[step.label],
        stop_functions=stops,
        space_mm=SPACES[int(command_of(asked.primitive_id)[2:]) % len(SPACES)],
        start_after=[] if step.label != "swing" else [closely_after(other) for other in asked.moving],
    )
    evaluation = EvaluationContext(context=asked.context, step=step, arm=arm)
    return BoundStep(subsystem="MCM", primitive=primitive, evaluation=evaluation, limit_s=LIMIT_S)


def closely_after(other: Primitive) -> StartAfter:
    """A swing follows another one in its middle, and has to be in time."""
    return StartAfter(primitive=other.id, path_s=0.004, within_s=0.03, further=[(0.008, 0.012), (0.016, 0.02)])


def analyze(data: bytes) -> Assessment:
    asked = read_report(data)
    report, evaluation = asked.report, asked.evaluation
    done = WorldChange(key=f"{evaluation.arm}.done", value=report.primitive)
    if asked.closing or report.reason is StopReason.HALT:
        suspect = WorldChange(key=f"{evaluation.arm}.done", validity=Validity.SUSPECT, keep_value=True)
        return Assessment(verdict="abort", reason=report.reason, changes=[suspect])
    good = report.reason is StopReason.GOAL
    expected = good or (report.reason is StopReason.TIMEOUT and evaluation.step.label == "late-skipped")
    if expected:
        return Assessment(verdict="continue", reason=report.reason, changes=[done])
    if evaluation.step.label == "late-mended" and report.reason is StopReason.TIMEOUT:
        return Assessment(verdict="trim", reason=report.reason, trim=1, changes=[done])
    changed = [] if report.reason is StopReason.REFUSED else [done]  # what was not begun has changed nothing
    return Assessment(verdict="abort", reason=report.reason, message=report.message, changes=changed)


def rehearse(data: bytes) -> Rehearsed:
    asked = read_rehearsal(data)
    parsed = msgspec.structs.replace(asked.parsed, test=False)
    return Rehearsed(rehearsal=Rehearsal(resources=["LEFT-ARM"]), parsed=parsed, after=Paper())


FUNCTIONS = {
    "parser": parse,
    "elaborator": elaborate,
    "binder": bind,
    "analyzer": analyze,
    "rehearser": rehearse,
}


def primitives_of(text: str) -> int:
    """How many primitives a run of this sentence takes, if it succeeds."""
    return sum(2 if word == "late-mended" else 1 for word in text.split()[2:] if word in STEPS and word != "let")
