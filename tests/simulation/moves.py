"""The move generator of the model check: every move that may come next, and the fair one when nothing goes wrong."""

from __future__ import annotations

from collections.abc import Iterator

from broker.decisions import effects as do
from broker.decisions import events
from broker.decisions.decide import decide
from broker.decisions.state import Command, LinkState
from rtc.protocol.messages import Phase, WorkerKind
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive_id import command_of
from tests.simulation.arrivals import event_of
from tests.simulation.model import (
    NEVER_EXHAUSTED,
    Model,
    Move,
    Scenario,
    at_work,
    decode,
    deferred_at_work,
    encode,
    sentence_of,
)


def moves(model: Model, scenario: Scenario) -> list[Move]:
    """All that may happen next."""
    return [move for move in _moves(model, scenario) if move[0] in NEVER_EXHAUSTED or _left(model, move[0]) > 0]


def _left(model: Model, fault: str) -> int:
    return min(model.faults, model.budget.get(fault, 1))


def _moves(model: Model, scenario: Scenario) -> Iterator[Move]:
    mcm, du = model.mcm, model.du
    if model.handed_in < len(scenario.sentences):
        yield "hand in", model.handed_in
    for command in du.commands.values():
        if at_work(model, command):
            for product in products(model, command, scenario):
                yield "work", command.id, product
            for fault in (
                "refuse",
                "nonsense",
                "worker dies",
                "job lost in a queue",
                "world away",
                "world away for long",
            ):
                yield fault, command.id
    for command in deferred_at_work(model):
        yield "world written", command
        for fault in ("write refused", "writer dies", "world still away"):
            yield fault, command
    if mcm.outbox:
        yield ("delivered",)
    for arm, primitive in mcm.arms.items():
        if not primitive:
            continue
        if arm in mcm.braking or primitive not in mcm.paused:
            yield ("rest" if arm in mcm.braking else "goal"), arm
        if arm not in mcm.braking and sentence_of(command_of(primitive), scenario).meets:
            yield "blocked", arm
            yield "cut", arm
    if mcm.alive:
        yield ("mcm dies",)
        if du.subsystems["MCM"].link is not LinkState.LOST and not mcm.outbox:
            yield ("mcm silent",)
        if du.subsystems["MCM"].link is not LinkState.CONNECTED and not any(
            type(outbox) is events.SubsystemConnected for outbox in mcm.outbox
        ):
            yield ("hello",)
        for primitive in mcm.kept:
            yield "send again", primitive
    else:
        yield ("born",)
        if not mcm.exit_reported:
            yield ("exit reported",)
    if not mcm.outbox:  # limits are long: messages arrive within them
        for timer in model.timers:
            yield "timer", timer
    for scope in scenario.halts:
        halt = model.halts.get(f"h-{scope}")
        if halt is None or not halt.at_broker:
            yield "halt", scope
        if mcm.alive and (halt is None or not halt.at_estop):
            yield "estop", scope
        if halt is not None and halt.at_broker:
            yield "halt again", scope
        if mcm.alive and halt is not None and halt.at_estop:
            yield "estop again", scope
    yield ("broker restarts",)
    if scenario.losses:
        yield ("journal lost",)
    if _left(model, "broker dies") > 0:
        yield from _deaths(model, scenario)
    if any(s.halt_if_lost for s in scenario.sentences):
        yield ("client gone",)
    if du.programs[WorkerKind.PARSER] == "old":
        yield ("program installed",)


def _deaths(model: Model, scenario: Scenario) -> Iterator[Move]:
    """The broker is killed while it handles an event: before the journal has it (None), or with so many effects out."""
    for move in _moves_of_broker(model, scenario):
        yield "broker dies", None, move
        trial = decode(encode(model))
        out = 0
        for effect in decide(trial.du, event_of(trial, scenario, move)):
            if isinstance(effect, do.SendPrimitive | do.SendPace | do.SendHalt | do.AcknowledgeReport | do.ReportEnd):
                yield "broker dies", out, move
                out += 1


def _moves_of_broker(model: Model, scenario: Scenario) -> Iterator[Move]:
    """Moves that are one event of the Decision Unit."""
    if model.handed_in < len(scenario.sentences):
        yield "hand in", model.handed_in
    for command in model.du.commands.values():
        if at_work(model, command):
            for product in products(model, command, scenario):
                yield "work", command.id, product
    for command in deferred_at_work(model):
        yield "world written", command
    if model.mcm.outbox:
        yield ("delivered",)
    for scope in scenario.halts:
        halt = model.halts.get(f"h-{scope}")
        yield ("halt again" if halt is not None and halt.at_broker else "halt"), scope


def products(model: Model, command: Command, scenario: Scenario) -> list[str]:
    """What a good worker may make of the job in hand."""
    assert command.job is not None
    if command.job.worker is WorkerKind.ANALYZER and command.phase is Phase.ANALYZING:
        if model.mcm.ended.get(command.primitive) is StopReason.BLOCKED:
            return ["blocked"]
        trims = sentence_of(command.id, scenario).trims
        return ["go on", "give up", *(f"trim {n}" for n in range(1, trims + 1))]
    if command.job.worker in (WorkerKind.ELABORATOR, WorkerKind.BINDER) and sentence_of(command.id, scenario).meets:
        return ["go on", "in the way"]
    return ["go on"]


def fair(model: Model, scenario: Scenario) -> Move | None:
    """What happens next when nothing goes wrong any more; a timer rings only when nothing else would happen."""
    mcm = model.mcm
    if not mcm.alive:
        return ("born",) if mcm.exit_reported else ("exit reported",)
    if mcm.outbox:
        return ("delivered",)
    if model.du.subsystems["MCM"].link is not LinkState.CONNECTED:
        return ("hello",)
    for arm, primitive in mcm.arms.items():
        if primitive and (arm in mcm.braking or primitive not in mcm.paused):
            return ("rest" if arm in mcm.braking else "goal"), arm
    for command in model.du.commands.values():
        if at_work(model, command):
            return "work", command.id, products(model, command, scenario)[0]
    for name in deferred_at_work(model):
        return "world written", name
    if mcm.kept:
        return "send again", next(iter(mcm.kept))
    if model.handed_in < len(scenario.sentences):
        return "hand in", model.handed_in
    for command in model.du.commands.values():
        if command.phase is Phase.EXECUTING and command.pause_wanted and command.primitive in mcm.paused:
            return "resume", command.id
    for timer in model.timers:
        return "timer", timer
    for command in model.du.commands.values():
        if command.phase is Phase.PAUSED:
            return "resume", command.id
    return None
