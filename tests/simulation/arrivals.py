"""What the broker receives in the model check: one event for each move, and late or repeated ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import msgspec

from broker.decisions import events
from broker.decisions.deferred_analysis import LIMIT_S
from broker.decisions.state import JobKind
from rtc.protocol import wire
from rtc.protocol.messages import BoundStep, WorkerKind
from rtc.protocol.outcomes import Refusal, RefusalReason, StopReason
from tests.broker.flat_events import made
from tests.broker.harness import bound, give_up, go_on, in_the_way, mend, record, rehearsed, report, script, trim
from tests.simulation.mcm_model import called
from tests.simulation.model import CLIENTS, Model, Move, Scenario, Sentence, sentence_of


def event_of(model: Model, scenario: Scenario, move: Move) -> events.Event:
    return EVENTS[move[0]](model, scenario, *move[1:])


def _hand_in(model: Model, scenario: Scenario, n: int) -> events.Event:
    model.handed_in = n + 1
    sentence = scenario.sentences[n]
    return made(
        events.CommandReceived,
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
    if product == "in the way":
        arm = sentence_of(command, scenario).meets
        about = {"job": live.job.id, "attempt": live.job.attempt, "node": "w"}
        return events.JobDeclined(at_s=model.now, refusal=in_the_way(arm), **about)
    step = live.actions.step if live.actions else None
    if live.job.kind is JobKind.REHEARSAL:
        body = wire.raw(rehearsed(record()))
    else:
        body = _product(sentence_of(command, scenario), live.job.worker, command, live.primitives + 1, step, product)
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
            if product == "blocked":
                return wire.raw(give_up(StopReason.BLOCKED))
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
    called(model, scope).at_broker = True
    return made(events.HaltCalled, at_s=model.now, client=CLIENTS[0], halt=f"h-{scope}", scope=scope)


def _call_again(model: Model, scenario: Scenario, scope: str) -> events.Event:
    return made(events.HaltCalled, at_s=model.now, client=CLIENTS[1], halt=f"h-{scope}", scope=scope)


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
    return made(events.HaltCalled, at_s=model.now, client=CLIENTS[0], halt=f"end-{command}", scope=command)


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


def late(model: Model) -> Iterator[events.Event]:
    """Events that may still arrive, or arrive once more, and must change nothing. They are answers of workers thought
    dead, repeated answers, reports and requests, and a timer that was set anew. (A halt that is repeated is obeyed
    again.)"""
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
        yield made(events.CommandReceived, at_s=now, client=client, request=request, text="X")
