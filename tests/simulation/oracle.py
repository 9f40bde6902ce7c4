"""The oracle of the model check: which effects of the Decision Unit contradict what the model has observed."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from broker.decisions import effects as do
from rtc.protocol.messages import CommandEnded, WorkerKind
from rtc.protocol.outcomes import OutcomeKind
from tests.simulation.model import Model


def stopped_by(model: Model, live: set[str], scope: str) -> list[str]:
    """Of a halt: the commands that must not go on. The Decision Unit counts the commands that hold, want or name an
    arm. Here only those that hold it count, because an observer sees no others."""
    du = model.du
    if scope == "ALL":
        return [c for c in live if c not in du.commands or not du.commands[c].text.startswith("HALT")]
    if scope in live:
        return [scope]
    return [c for c in live if scope in du.resources.held.get(c, ())]


def contradictions(model: Model, effect: do.Effect) -> Iterator[str]:
    """What an effect must not be, seen from outside."""
    match effect:
        case do.DispatchJob() if effect.kind is not WorkerKind.ANALYZER:
            command = effect.job.partition("/")[0]
            if command in model.stopped:
                yield f"a job for {command}, which was halted"
        case do.SendPrimitive() if effect.id.partition(".")[0] in model.stopped:
            yield f"primitive {effect.id} for a command that was halted"
        case do.SendPrimitive():
            yield from _overtaken(model, effect)
        case do.ReportEnd():
            yield from _untrue_end(model, effect.ended)


def _overtaken(model: Model, effect: do.SendPrimitive) -> Iterator[str]:
    """What one client gave is begun in the order given, as far as the sentences name the same arm."""
    du, command = model.du, model.du.commands[effect.id.partition(".")[0]]
    performer = msgspec.msgpack.decode(effect.primitive)["performer"]
    for earlier in du.commands.values():  # in order of acceptance
        if earlier is command:
            return
        unread = earlier.id in du.intake_order.get(earlier.client, ())
        named = earlier.head is not None and earlier.head.hand == performer and earlier.id in du.resources.waiting
        if earlier.client == command.client and (unread or named):
            yield f"primitive {effect.id} before {earlier.id}, which was given before it"


def _untrue_end(model: Model, ended: CommandEnded) -> Iterator[str]:
    command, kind = ended.command, ended.outcome.kind
    begun = [primitive for primitive in model.begun if primitive.partition(".")[0] == command]
    moving = [p for a, p in model.mcm.arms.items() if p in begun]
    if command in model.outcomes:
        yield f"{command} ended twice: {model.outcomes[command]}, {kind.value}"
    if kind is OutcomeKind.SUCCEEDED:
        if command in model.stopped:
            yield f"{command} was halted, and succeeded"
        if begun and model.goals.get(command, 0) + model.cut.get(command, 0) != len(begun):
            yield f"{command} succeeded with {model.goals.get(command, 0)} of {len(begun)} primitives at their goal"
    if moving and kind not in (OutcomeKind.HALT_NOT_CONFIRMED, OutcomeKind.LOST_SUBSYSTEM):
        yield f"{command} ended {kind.value}, and {moving[0]} still moves"
