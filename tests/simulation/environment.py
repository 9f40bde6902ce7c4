"""The environment model of the model check: carries out one move around the real Decision Unit.

The real `decide` runs on a real `State`. The model around it is adverse but within the rules. Workers answer, refuse or
die. A subsystem executes, brakes, rests, dies, is silent and returns. Timers expire. A halt takes either of its two
ways. The broker is killed before an event is journalled, or after that and before any one of its effects has left.
Messages of the subsystem arrive in order, with any delay. Messages to it arrive with the batch. Whether it acts before
or after is a move of its own, so the Decision Unit sees every order. Times never matter: any timer may fire.

`happen` carries out one move and checks the rules (`oracle`). `moves` lists the moves, `arrivals` has the events of
the broker, `mcm_model` the MCM; `state_key` identifies a state.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from broker.decisions import effects as do
from broker.decisions import events
from broker.decisions.decide import decide
from broker.decisions.state import State
from rtc.protocol import wire
from rtc.protocol.messages import Phase, WorkerKind
from tests.simulation.arrivals import event_of
from tests.simulation.invariants import forbidden, violations
from tests.simulation.mcm_model import OF_MCM, acknowledge, called, execute, hello, order_halt, pace, send_hello
from tests.simulation.model import (
    ARMS,
    NEVER_EXHAUSTED,
    Mcm,
    Model,
    Move,
    Scenario,
    Violation,
)
from tests.simulation.oracle import contradictions, stopped_by

_encode_state, _decode_state = wire.encode, wire.decoder(State)


def first(scenario: Scenario) -> Model:
    """Before the first sentence: the subsystem is there and at rest."""
    model = Model(du=State(), mcm=Mcm(arms=dict.fromkeys(ARMS, "")), budget=dict(scenario.caps), faults=scenario.faults)
    for kind in WorkerKind:
        _handle(model, events.ProgramInstalled(at_s=0.0, kind=kind, digest="old"))
    _handle(model, hello(model))
    return model


def happen(model: Model, scenario: Scenario, move: Move, *, paid: bool = True) -> list[do.Effect]:
    """Do one move. Raises Violation. `paid`: it counts against the faults that may happen."""
    model.now += 1.0
    name = move[0]
    if paid and name not in NEVER_EXHAUSTED:
        model.faults -= 1
        model.budget[name] = model.budget.get(name, 1) - 1
    if name in OF_MCM:
        OF_MCM[name](model, *move[1:])
        return []
    if name == "broker dies":
        _, out, inner = move
        if out is None:
            _lose(model, inner)
        else:
            _handle(model, event_of(model, scenario, inner), out=out)
        return _restart(model)
    if name == "broker restarts":
        return _restart(model)
    if name == "journal lost":
        return _lose_turns(model)
    return _handle(model, event_of(model, scenario, move))


def _lose_turns(model: Model) -> list[do.Effect]:
    """A broker comes that knows that turns are missing. Nothing that was live goes on."""
    done = _restart(model)
    lost = events.JournalLost(at_s=model.now, why="lost", life="", accepted=model.du.accepted)
    done += _handle(model, lost)
    for command in model.du.commands.values():
        if command.phase not in (Phase.HALTING, Phase.CLOSING):
            raise Violation(f"{command.id} is {command.phase.value} after its journal was lost")
    return done


def _handle(model: Model, event: events.Event, out: int | None = None) -> list[do.Effect]:
    """Let the Decision Unit handle an event; perform its effects, or only the first `out` that leave the broker."""
    du = model.du
    live = set(du.commands)
    halted = event.order.scope if isinstance(event, events.HaltCalled) else ""
    effects = decide(du, event)
    for command in du.commands.values():
        command.notes.clear()  # published, and never read again
    du.counts.clear()
    wrong = [*violations(du), *forbidden(du, live, effects, halt_all=halted == "ALL")]
    if halted:
        model.stopped += [c for c in stopped_by(model, live, halted) if c not in model.stopped]
    for effect in effects:
        wrong += contradictions(model, effect)
    if wrong:
        raise Violation("; ".join(wrong))
    for effect in effects:
        leaves = isinstance(effect, do.SendPrimitive | do.SendPace | do.SendHalt | do.AcknowledgeReport | do.ReportEnd)
        if out is not None and leaves:
            if out == 0:
                break
            out -= 1
        if carry := CARRIED_OUT.get(type(effect)):
            carry(model, effect)
    return effects


def _restart(model: Model) -> list[do.Effect]:
    """A new broker on the old journal. What the old one had not read is gone; the subsystem introduces itself anew."""
    model.du = _decode_state(_encode_state(model.du))
    model.timers.clear()
    model.given.clear()
    model.mcm.outbox.clear()
    effects = _handle(model, events.BrokerRestarted(at_s=model.now))
    if model.mcm.alive:
        send_hello(model)
    return effects


def _lose(model: Model, move: Move) -> None:
    """What the broker had read is lost with it. Some senders repeat their messages."""
    if move[0] == "delivered":
        model.mcm.outbox.pop(0)
    elif move[0] == "halt":
        called(model, move[1]).at_broker = True


def _give(model: Model, effect: do.DispatchJob) -> None:
    model.given[effect.job] = effect.attempt


def _cancel(model: Model, effect: do.CancelJob) -> None:
    model.given.pop(effect.job, None)


def _start_timer(model: Model, effect: do.StartTimer) -> None:
    model.timers[effect.timer] = effect.at_s


def _stop_timer(model: Model, effect: do.StopTimer) -> None:
    model.timers.pop(effect.timer, None)


def _ended(model: Model, effect: do.ReportEnd) -> None:
    model.outcomes[effect.ended.command] = effect.ended.outcome.kind.value


CARRIED_OUT: dict[type[do.Effect], Callable[[Model, Any], None]] = {
    do.DispatchJob: _give,
    do.CancelJob: _cancel,
    do.SendPrimitive: execute,
    do.SendPace: pace,
    do.SendHalt: order_halt,
    do.AcknowledgeReport: acknowledge,
    do.StartTimer: _start_timer,
    do.StopTimer: _stop_timer,
    do.ReportEnd: _ended,
}
