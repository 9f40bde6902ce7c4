"""AFTER and TOGETHER-WITH: a command waits until another one has succeeded or begins to move (R116). Pure."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from broker.decisions.command import surrender
from broker.decisions.command.claims import claim_and_elaborate
from broker.decisions.command.termination import end, refuse
from broker.decisions.context import DecisionContext
from broker.decisions.state import Command, ParsedHead, PendingOutcome
from rtc.protocol.advice import by_person
from rtc.protocol.messages import NoteKind, Phase
from rtc.protocol.outcomes import Refusal, RefusalReason


def wait_for_another(context: DecisionContext, command: Command, head: ParsedHead) -> bool:
    """Handle AFTER and TOGETHER-WITH (R116). True: the command waits, or it was refused."""
    other = head.after or head.together_with
    if other is None:
        return False
    state = context.state
    target = state.commands.get(other)
    if target is None or target is command:
        done = state.ended[other].succeeded if other in state.ended else None
        if head.after and done:
            return False
        if head.after and other in state.surrenders:
            surrender.hold(context, command, other)
            return True
        message = (
            f"{command.id} cannot come after itself"
            if target is command
            else f"{other} has ended without success"
            if done is False
            else f"{other} has ended, it cannot be joined"
            if done
            else f"there is no command {other}"
        )
        reason = RefusalReason.NAME if target is None and done is None else RefusalReason.STATE
        clears = f"leave out {'AFTER' if head.after else 'TOGETHER-WITH'} {other}"
        refuse(context, command, Refusal(reason=reason, message=message, clears=by_person(clears)))
        return True
    if command.id in _waits_for(context, target):
        message = f"{command.id} and {other} would wait for each other without end"
        refuse(context, command, Refusal(reason=RefusalReason.STATE, message=message, owner=other))
        return True
    if head.together_with and target.primitives:
        return False
    line = state.awaiting if head.after else state.joining
    line.setdefault(other, []).append(command.id)
    context.enter(command, Phase.HELD, NoteKind.AFTER if head.after else NoteKind.TOGETHER, owner=other)
    return True


def _waits_for(context: DecisionContext, command: Command | None) -> Collection[str]:
    """The commands that this one waits for by AFTER or TOGETHER-WITH, in a chain that starts with itself."""
    chain: dict[str, None] = {}
    while command is not None and command.id not in chain:
        chain[command.id] = None
        other = command.head and (command.head.after or command.head.together_with)
        command = context.state.commands.get(other) if other else None
    return chain


def on_resumed(context: DecisionContext, command: Command, _: Any) -> None:
    """Withdraw a pause; go on without the operator if the command waits for one."""
    command.pause_wanted = command.single_step = False
    if surrender.is_held(context, command.id):
        surrender.release(context, command.id)
        claim_and_elaborate(context, command)


def on_released(context: DecisionContext, command: Command, begun_or_succeeded: bool | PendingOutcome) -> None:
    """Begin after another command, or not; end an answer of the operator, which is settled."""
    if isinstance(begun_or_succeeded, PendingOutcome):
        end(context, command, begun_or_succeeded)
        return
    if begun_or_succeeded:
        claim_and_elaborate(context, command)
        return
    assert command.head is not None
    other = command.head.after or command.head.together_with
    what = "ended without success" if command.head.after else "ended before it began to move"
    refuse(context, command, Refusal(reason=RefusalReason.STATE, message=f"{other} {what}", owner=other or ""))
