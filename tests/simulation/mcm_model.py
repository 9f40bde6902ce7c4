"""The model of the MCM in the model check: it executes, pauses, brakes, rests, dies and returns.

Its messages wait in `Mcm.outbox` until a move delivers them to the broker.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from broker.decisions import effects as do
from broker.decisions import events
from rtc.protocol.messages import EndReport
from rtc.protocol.outcomes import StopReason
from tests.broker.flat_events import made
from tests.broker.harness import report
from tests.simulation.model import ARMS, Halt, Mcm, Model, OpenHalt, Violation


def called(model: Model, scope: str) -> Halt:
    return model.halts.setdefault(f"h-{scope}", Halt(scope, model.handed_in))


def hello(model: Model) -> events.SubsystemConnected:
    mcm = model.mcm
    executing = [primitive for primitive in mcm.arms.values() if primitive]
    return made(
        events.SubsystemConnected,
        at_s=model.now,
        subsystem="MCM",
        pid=mcm.pid,
        performers=list(ARMS),
        outstanding=executing + [primitive for primitive in mcm.kept if primitive not in executing],
        at_rest=not executing,
        pauses=True,
        paused=[primitive for primitive in executing if primitive in mcm.paused],
    )


def _send(model: Model, event: events.AnyEvent) -> None:
    model.mcm.outbox.append(event)


def execute(model: Model, effect: do.SendPrimitive) -> None:
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
    body: EndReport = report(primitive, reason, performer, duration_s=1.0 if primitive in model.begun else 0.0)
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


def _cut(model: Model, arm: str) -> None:
    """It stands on its way: another arm will not leave the space that it needs next."""
    command = model.mcm.arms[arm].partition(".")[0]
    model.cut[command] = model.cut.get(command, 0) + 1
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
    _send(model, made(events.HaltCalled, at_s=0.0, client="MCM", halt=call.partition("#")[0], scope=scope, call=call))


def _confirm(model: Model) -> None:
    mcm = model.mcm
    for halt in list(mcm.open):
        if not any(mcm.arms[arm] for arm in halt.performers):
            mcm.open.remove(halt)
            rest = {"subsystem": "MCM", "halt": halt.id, "at_rest": True, "performers": halt.performers}
            _send(model, made(events.HaltConfirmed, at_s=0.0, **rest))


def _estop(model: Model, scope: str) -> None:
    halt = called(model, scope)
    halt.at_estop = True
    _at_estop(model, halt, halt.handed_in)


def _estop_again(model: Model, scope: str) -> None:
    """Another halt under a name that was used before: by a second caller, or by a button that always says the same."""
    _at_estop(model, called(model, scope), model.handed_in)


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
    send_hello(model)


def send_hello(model: Model) -> None:
    _send(model, hello(model))
    for primitive in model.mcm.kept:
        _report(model, primitive)
    for scope, call in model.mcm.fences.items():
        _pass_on(model, call, scope)


def _send_again(model: Model, primitive: str) -> None:
    _report(model, primitive)


OF_MCM: dict[str, Callable[..., None]] = {
    "goal": _goal,
    "blocked": _blocked,
    "cut": _cut,
    "rest": _rest,
    "estop": _estop,
    "estop again": _estop_again,
    "mcm dies": _die,
    "born": _born,
    "hello": send_hello,
    "send again": _send_again,
}


def pace(model: Model, effect: do.SendPace) -> None:
    mcm = model.mcm
    if mcm.alive and effect.primitive in mcm.arms.values():
        others = [primitive for primitive in mcm.paused if primitive != effect.primitive]
        mcm.paused = [*others, effect.primitive] if effect.paused else others


def order_halt(model: Model, effect: do.SendHalt) -> None:
    order = effect.order
    _halt(model, order.halt, order.scope, call=order.call)


def acknowledge(model: Model, effect: do.AcknowledgeReport) -> None:
    model.mcm.kept.pop(effect.primitive, None)
