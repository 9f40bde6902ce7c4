"""The environment model of the model check: carries out one move around the real Decision Unit.

The real `decide` runs on a real `State`. The model around it is adverse but within the rules. Workers answer, refuse or
die. A subsystem executes, brakes, rests, dies, is silent and returns. Timers expire. A halt takes either of its two
ways. The broker is killed before an event is journalled, or after that and before any one of its effects has left.
Messages of the subsystem arrive in order, with any delay. Messages to it arrive with the turn: whether it acts before
or after is a move of its own, so the Decision Unit sees every order. Times never matter: any timer may fire.

`happen` carries out one move and checks the rules (`oracle`). `moves` lists the moves; `state_key` identifies a state.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import msgspec

from broker.decisions import effects as do
from broker.decisions import events
from broker.decisions.decide import decide
from broker.decisions.deferred_analysis import LIMIT_S
from broker.decisions.invariants import forbidden, violations
from broker.decisions.state import State
from rtc.protocol import wire
from rtc.protocol.messages import BoundStep, EndReport, Phase, WorkerKind
from rtc.protocol.outcomes import IN_THE_WAY, Refusal, RefusalReason, StopReason
from tests.broker.harness import bound, give_up, go_on, in_the_way, mend, record, report, script, trim
from tests.simulation.model import (
    ARMS,
    CLIENTS,
    NEVER_EXHAUSTED,
    Halt,
    Mcm,
    Model,
    Move,
    OpenHalt,
    Scenario,
    Sentence,
    Violation,
    sentence_of,
)
from tests.simulation.oracle import contradictions, stopped_by

_encode_state, _decode_state = wire.encode, wire.decoder(State)


def first(scenario: Scenario) -> Model:
    """Before the first sentence: the subsystem is there and at rest."""
    model = Model(du=State(), mcm=Mcm(arms=dict.fromkeys(ARMS, "")), budget=dict(scenario.caps), faults=scenario.faults)
    for kind in WorkerKind:
        _handle(model, events.ProgramInstalled(at_s=0.0, kind=kind, digest="old"))
    _handle(model, _hello(model))
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


def event_of(model: Model, scenario: Scenario, move: Move) -> events.Event:
    return EVENTS[move[0]](model, scenario, *move[1:])


def _hand_in(model: Model, scenario: Scenario, n: int) -> events.Event:
    model.handed_in = n + 1
    sentence = scenario.sentences[n]
    return events.CommandReceived(
        at_s=model.now,
        client=_client(scenario, n),
        request=f"r{n}",
        text=sentence.text,
        halt_if_lost=sentence.halt_if_lost,
    )


def _client(scenario: Scenario, n: int) -> str:
    return CLIENTS[0 if scenario.one_client else n]


def _client_gone(model: Model, scenario: Scenario) -> events.Event:
    tied = next(n for n, sentence in enumerate(scenario.sentences) if sentence.halt_if_lost)
    return events.ClientGone(at_s=model.now, client=_client(scenario, tied))


def _work(model: Model, scenario: Scenario, command: str, product: str) -> events.Event:
    live = model.du.commands[command]
    assert live.job is not None
    del model.given[live.job.id]
    if product == IN_THE_WAY:
        arm = sentence_of(command, scenario).meets
        about = {"job": live.job.id, "attempt": live.job.attempt, "node": "w"}
        return events.JobDeclined(at_s=model.now, refusal=in_the_way(arm), **about)
    step = live.actions.step if live.actions else None
    body = _product(sentence_of(command, scenario), live.job.kind, command, live.primitives + 1, step, product)
    return events.JobFinished(at_s=model.now, job=live.job.id, attempt=live.job.attempt, node="w", product=body)


@cache
def _product(
    sentence: Sentence, kind: WorkerKind, command: str, primitive: int, step: tuple[int, int] | None, product: str
) -> msgspec.Raw:
    arm = sentence.arms[0]
    match kind:
        case WorkerKind.PARSER:
            return wire.raw(record(**{"hand": arm, **dict(sentence.parsed)}))
        case WorkerKind.ELABORATOR:
            trims = [trim(n, "retry_step") for n in range(1, sentence.trims + 1)]
            return wire.raw(script(sentence.steps + sentence.empty_steps, sentence.arms, trims))
        case WorkerKind.BINDER:
            assert step is not None
            if step[0] == 0 and step[1] < sentence.empty_steps:
                return wire.raw(BoundStep(note="nothing to do"))
            if sentence.stated:
                return wire.raw(BoundStep(report=report("", StopReason.GOAL), evaluation=bound("").evaluation))
            arm = sentence.arms[(primitive - 1) % len(sentence.arms)]
            return wire.raw(bound(f"{command}.{primitive}", arm, moves=sentence.moves))
        case WorkerKind.ANALYZER:
            if product.startswith("trim"):
                return wire.raw(mend(int(product[5:])))
            return wire.raw(give_up() if product == "give up" else go_on())


def _about_job(
    kind: type[events.JobFinished | events.JobDeclined | events.JobLost], **fields: Any
) -> Callable[[Model, Scenario, str], events.Event]:
    def event(model: Model, scenario: Scenario, command: str) -> events.Event:
        job = model.du.commands[command].job
        assert job is not None
        del model.given[job.id]
        return kind(at_s=model.now, job=job.id, attempt=job.attempt, node="w", **fields)

    return event


def _away_for_long(model: Model, scenario: Scenario, command: str) -> events.Event:
    model.now += LIMIT_S + 1.0
    return _about_job(events.JobDeclined, refusal=AWAY)(model, scenario, command)


def _about_deferred(
    kind: type[events.JobFinished | events.JobDeclined | events.JobLost], **fields: Any
) -> Callable[[Model, Scenario, str], events.Event]:
    def event(model: Model, scenario: Scenario, command: str) -> events.Event:
        job = model.du.deferred_analyses[command].job
        del model.given[job.id]
        return kind(at_s=model.now, job=job.id, attempt=job.attempt, node="w", **fields)

    return event


def _call(model: Model, scenario: Scenario, scope: str) -> events.Event:
    _called(model, scope).at_broker = True
    return events.HaltCalled(at_s=model.now, client=CLIENTS[0], halt=f"h-{scope}", scope=scope)


def _call_again(model: Model, scenario: Scenario, scope: str) -> events.Event:
    return events.HaltCalled(at_s=model.now, client=CLIENTS[1], halt=f"h-{scope}", scope=scope)


def _called(model: Model, scope: str) -> Halt:
    return model.halts.setdefault(f"h-{scope}", Halt(scope, model.handed_in))


def _hello(model: Model) -> events.SubsystemConnected:
    mcm = model.mcm
    executing = [primitive for primitive in mcm.arms.values() if primitive]
    return events.SubsystemConnected(
        at_s=model.now,
        subsystem="MCM",
        pid=mcm.pid,
        performers=list(ARMS),
        outstanding=executing + [primitive for primitive in mcm.kept if primitive not in executing],
        at_rest=not executing,
        pauses=True,
        paused=[primitive for primitive in executing if primitive in mcm.paused],
    )


def _gone(why: str) -> Callable[[Model, Scenario], events.Event]:
    def event(model: Model, scenario: Scenario) -> events.Event:
        model.mcm.exit_reported = True
        return events.SubsystemGone(at_s=model.now, subsystem="MCM", why=why)

    return event


def _next_sent(model: Model, scenario: Scenario) -> events.Event:
    return msgspec.structs.replace(model.mcm.outbox.pop(0), at_s=model.now)


def _ring(model: Model, scenario: Scenario, timer: str) -> events.Event:
    at_s = model.timers.pop(timer)
    return events.TimerFired(at_s=max(at_s, model.now), timer=timer)


def _install(model: Model, scenario: Scenario) -> events.Event:
    return events.ProgramInstalled(at_s=model.now, kind=WorkerKind.PARSER, digest="new")


def _resume(model: Model, scenario: Scenario, command: str) -> events.Event:
    """The operator gives up on a paused command: it need not go on, only end."""
    return events.HaltCalled(at_s=model.now, client=CLIENTS[0], halt=f"end-{command}", scope=command)


NO = Refusal(reason=RefusalReason.INFEASIBLE, message="no")


AWAY = Refusal(reason=RefusalReason.TIMEOUT, message="the world does not answer")


EVENTS: dict[str, Callable[..., events.Event]] = {
    "hand in": _hand_in,
    "work": _work,
    "refuse": _about_job(events.JobDeclined, refusal=NO),
    "nonsense": _about_job(events.JobFinished, product=wire.raw({"no": "product"})),
    "worker dies": _about_job(events.JobLost, evidence="exit -9"),
    "job lost in a queue": _about_job(events.JobLost, evidence="exit -9", blamed=False),
    "world away": _about_job(events.JobDeclined, refusal=AWAY),
    "world away for long": _away_for_long,
    "world written": _about_deferred(events.JobFinished, product=wire.raw(go_on())),
    "write refused": _about_deferred(events.JobDeclined, refusal=NO),
    "writer dies": _about_deferred(events.JobLost, evidence="exit -9"),
    "world still away": _about_deferred(events.JobDeclined, refusal=AWAY),
    "delivered": _next_sent,
    "mcm silent": _gone("silent"),
    "exit reported": _gone("exit -9"),
    "timer": _ring,
    "halt": _call,
    "halt again": _call_again,
    "client gone": _client_gone,
    "program installed": _install,
    "resume": _resume,
}


def _handle(model: Model, event: events.Event, out: int | None = None) -> list[do.Effect]:
    """Let the Decision Unit handle an event; perform its effects, or only the first `out` that leave the broker."""
    du = model.du
    live = set(du.commands)
    halted = event.scope if isinstance(event, events.HaltCalled) else ""
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
        _send_hello(model)
    return effects


def _lose(model: Model, move: Move) -> None:
    """What the broker had read is lost with it. Some senders repeat their messages."""
    if move[0] == "delivered":
        model.mcm.outbox.pop(0)
    elif move[0] == "halt":
        _called(model, move[1]).at_broker = True


def late(model: Model) -> Iterator[events.Event]:
    """What may still arrive, or arrive once more, and must change nothing: answers of workers thought dead, answers
    and repeated reports, requests repeated, a timer that was set anew. (A halt that is repeated is obeyed again.)"""
    now, body = model.now, wire.raw(go_on())
    old = [(f"{command}/1", 1) for command in model.outcomes]
    old += [(left.job.id, left.job.attempt - 1) for left in model.du.deferred_analyses.values()]
    for live in model.du.commands.values():
        old.append((f"{live.id}/{live.jobs if live.job is None else live.jobs - 1}", 1))
        if live.job is not None:
            old.append((live.job.id, live.job.attempt - 1))
        yield events.TimerFired(at_s=live.due_s - 0.5 if live.due_s else now, timer=live.id)
    for job, attempt in old:
        yield events.JobFinished(at_s=now, job=job, attempt=attempt, node="late", product=body)
        yield events.JobDeclined(at_s=now, job=job, attempt=attempt, node="late", refusal=NO)
        yield events.JobLost(at_s=now, job=job, attempt=attempt, node="late", evidence="late")
    for primitive, reason in model.mcm.ended.items():
        if primitive not in model.mcm.kept:
            yield events.PrimitiveEnded(at_s=now, subsystem="MCM", report=report(primitive, reason))
    for key in model.du.requests:
        client, _, request = key.partition(" ")
        yield events.CommandReceived(at_s=now, client=client, request=request, text="X")


def _send(model: Model, event: events.AnyEvent) -> None:
    model.mcm.outbox.append(event)


def _execute(model: Model, effect: do.SendPrimitive) -> None:
    mcm, id_ = model.mcm, effect.id
    if not mcm.alive or effect.pid != mcm.pid:
        return
    performer = msgspec.msgpack.decode(effect.primitive)["performer"]
    if id_ in mcm.ended:
        _report(model, id_)
        return
    if mcm.arms[performer] == id_:
        return
    scopes = ("ALL", performer, id_.partition(".")[0])
    if any(scope in scopes for scope in mcm.fences):
        mcm.ended[id_] = mcm.kept[id_] = StopReason.HALT
        _report(model, id_)
        return
    if mcm.arms[performer]:
        raise Violation(f"{id_} was sent to {performer}, which still executes {mcm.arms[performer]}")
    if id_ in model.begun:
        raise Violation(f"{id_} is executed a second time")
    if id_.partition(".")[0] in [*model.stopped, *model.estopped]:
        raise Violation(f"{id_} begins after the halt that stopped its command")
    mcm.arms[performer] = id_
    model.begun[id_] = performer


def _report(model: Model, primitive: str) -> None:
    reason = model.mcm.ended[primitive]
    performer = model.begun.get(primitive, "RIGHT-ARM")
    body: EndReport = report(primitive, reason, performer)
    _send(model, events.PrimitiveEnded(at_s=0.0, subsystem="MCM", report=body))


def _end(model: Model, arm: str, reason: StopReason) -> None:
    mcm = model.mcm
    primitive, mcm.arms[arm] = mcm.arms[arm], ""
    mcm.ended[primitive] = mcm.kept[primitive] = reason
    mcm.braking = [a for a in mcm.braking if a != arm]
    mcm.paused = [name for name in mcm.paused if name != primitive]
    _report(model, primitive)


def _goal(model: Model, arm: str) -> None:
    command = model.mcm.arms[arm].partition(".")[0]
    model.goals[command] = model.goals.get(command, 0) + 1
    _end(model, arm, StopReason.GOAL)
    _confirm(model)


def _blocked(model: Model, arm: str) -> None:
    """It is not begun: another arm has not left its space."""
    del model.begun[model.mcm.arms[arm]]
    _end(model, arm, StopReason.BLOCKED)
    _confirm(model)


def _rest(model: Model, arm: str) -> None:
    _end(model, arm, StopReason.HALT)
    _confirm(model)


def _halt(model: Model, id_: str, scope: str, *, call: str) -> None:
    """Ordered by the broker. `call`: of the halt past it that this answers, if it does."""
    mcm = model.mcm
    if not mcm.alive:
        return
    mcm.fences = {s: c for s, c in mcm.fences.items() if c != call}
    reached = _brake(mcm, scope)
    in_scope = list(ARMS) if scope == "ALL" else [scope] if scope in ARMS else reached
    mcm.open.append(OpenHalt(id_, in_scope))
    _confirm(model)


def _brake(mcm: Mcm, scope: str) -> list[str]:
    reached = [a for a, p in mcm.arms.items() if p and (scope in ("ALL", a) or p.startswith(f"{scope}."))]
    mcm.braking += [a for a in reached if a not in mcm.braking]
    return reached


def _pass_on(model: Model, call: str, scope: str) -> None:
    _send(model, events.HaltCalled(at_s=0.0, client="MCM", halt=call.partition("#")[0], scope=scope, call=call))


def _confirm(model: Model) -> None:
    mcm = model.mcm
    for halt in list(mcm.open):
        if not any(mcm.arms[arm] for arm in halt.performers):
            mcm.open.remove(halt)
            rest = {"subsystem": "MCM", "halt": halt.id, "at_rest": True, "performers": halt.performers}
            _send(model, events.HaltConfirmed(at_s=0.0, **rest))


def _estop(model: Model, scope: str) -> None:
    halt = _called(model, scope)
    halt.at_estop = True
    _at_estop(model, halt, halt.handed_in)


def _estop_again(model: Model, scope: str) -> None:
    """Another halt under a name that was used before: by a second caller, or by a button that always says the same."""
    _at_estop(model, _called(model, scope), model.handed_in)


def _at_estop(model: Model, halt: Halt, handed_in: int) -> None:
    halt.estops += 1
    call = f"h-{halt.scope}#{halt.estops}"
    _brake(model.mcm, halt.scope)
    model.mcm.fences[halt.scope] = call
    _pass_on(model, call, halt.scope)
    before = [f"C-{n}" for n in range(1, handed_in + 1)]
    model.estopped += [c for c in before if halt.scope in ("ALL", c) and c not in model.estopped]


def _die(model: Model) -> None:
    """Killed. The arms stop where they are; what was sent may still arrive. What it alone knew is lost."""
    mcm = model.mcm
    model.estopped.clear()
    model.mcm = Mcm(pid=mcm.pid, alive=False, exit_reported=False, arms=dict.fromkeys(ARMS, ""), outbox=mcm.outbox)


def _born(model: Model) -> None:
    mcm = model.mcm
    mcm.pid, mcm.alive = mcm.pid + 1, True
    _send_hello(model)


def _send_hello(model: Model) -> None:
    _send(model, _hello(model))
    for primitive in model.mcm.kept:
        _report(model, primitive)
    for scope, call in model.mcm.fences.items():
        _pass_on(model, call, scope)


def _send_again(model: Model, primitive: str) -> None:
    _report(model, primitive)


OF_MCM: dict[str, Callable[..., None]] = {
    "goal": _goal,
    "blocked": _blocked,
    "rest": _rest,
    "estop": _estop,
    "estop again": _estop_again,
    "mcm dies": _die,
    "born": _born,
    "hello": _send_hello,
    "send again": _send_again,
}


def _pace(model: Model, effect: do.SendPace) -> None:
    mcm = model.mcm
    if mcm.alive and effect.primitive in mcm.arms.values():
        others = [primitive for primitive in mcm.paused if primitive != effect.primitive]
        mcm.paused = [*others, effect.primitive] if effect.paused else others


def _order_halt(model: Model, effect: do.SendHalt) -> None:
    _halt(model, effect.halt, effect.scope, call=effect.call)


def _give(model: Model, effect: do.DispatchJob) -> None:
    model.given[effect.job] = effect.attempt


def _cancel(model: Model, effect: do.CancelJob) -> None:
    model.given.pop(effect.job, None)


def _acknowledge(model: Model, effect: do.AcknowledgeReport) -> None:
    model.mcm.kept.pop(effect.primitive, None)


def _start_timer(model: Model, effect: do.StartTimer) -> None:
    model.timers[effect.timer] = effect.at_s


def _stop_timer(model: Model, effect: do.StopTimer) -> None:
    model.timers.pop(effect.timer, None)


def _ended(model: Model, effect: do.ReportEnd) -> None:
    model.outcomes[effect.ended.command] = effect.ended.outcome.kind.value


CARRIED_OUT: dict[type[do.Effect], Callable[[Model, Any], None]] = {
    do.DispatchJob: _give,
    do.CancelJob: _cancel,
    do.SendPrimitive: _execute,
    do.SendPace: _pace,
    do.SendHalt: _order_halt,
    do.AcknowledgeReport: _acknowledge,
    do.StartTimer: _start_timer,
    do.StopTimer: _stop_timer,
    do.ReportEnd: _ended,
}
