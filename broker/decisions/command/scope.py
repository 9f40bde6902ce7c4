"""Scopes of HALT, PAUSE, RESUME and ABORT: which live commands and which subsystem a name stands for. Pure."""

from __future__ import annotations

from broker.decisions.context import DecisionContext
from broker.decisions.state import Command, ParsedHead
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.sentence import BOTH_ARMS


def scope_of(head: ParsedHead) -> str:
    """The scope that a control sentence names; without a name it is ALL."""
    scope = head.object or head.hand or "ALL"
    return "ALL" if scope == BOTH_ARMS else scope


def in_scope(context: DecisionContext, scope: str) -> list[Command]:
    """The live commands in a scope: all, one by its number, or those that hold, want or name a resource."""
    state = context.state
    if scope == "ALL":
        return list(state.commands.values())
    if scope in state.commands:
        return [state.commands[scope]]
    claim = {*state.resources.holders.get(scope, ()), *state.resources.lines.get(scope, ())}
    hands = {scope, BOTH_ARMS} if subsystem_of(context, scope) else {scope} - {BOTH_ARMS}
    return [c for c in state.commands.values() if c.id in claim or (c.head and _names(c.head, scope, hands))]


def behind(context: DecisionContext, command: Command) -> list[Command]:
    """The commands in line for what this one holds, and for what those want: without it, and without them, the next
    would begin by itself. None for a command that waits in line itself."""
    state, found, opened = context.state, {command.id}, [command.id]
    for one in opened:  # it grows
        claim = (state.resources.held if one == command.id else state.resources.waiting).get(one, {})
        for name, exclusive in claim.items():
            for other in state.resources.lines.get(name, ()):
                if other not in found and (exclusive or state.resources.waiting[other][name]):
                    found.add(other)
                    opened.append(other)
    return [state.commands[one] for one in opened[1:] if one in state.commands]


def _names(head: ParsedHead, scope: str, hands: set[str]) -> bool:
    return head.kind == "task" and (head.object == scope or head.hand in hands or head.to_hand in hands)


def subsystem_of(context: DecisionContext, performer: str) -> str:
    return next((n for n, s in context.state.subsystems.items() if performer in s.performers), "")


def has_ended(context: DecisionContext, scope: str) -> bool:
    """True if the scope is the number of an accepted command that is not live, however old."""
    number = scope.removeprefix("C-")
    named = scope not in context.state.commands and scope == f"C-{number}" and number.isascii() and number.isdigit()
    return named and 0 < int(number[:18]) <= context.state.accepted


def no_target(context: DecisionContext, scope: str, asker: str = "") -> Refusal:
    """The refusal for an empty scope. `asker`: the command that named it, left out of the suggestions."""
    if has_ended(context, scope):
        return Refusal(reason=RefusalReason.STATE, message=f"{scope} has already ended")
    live = [command for command in context.state.commands if command != asker]
    known = [*(p for s in context.state.subsystems.values() for p in s.performers), *live]
    message = f"no live command or performer is named {scope}"
    clears = "name ALL, an arm or a command in progress: rtc status lists them"
    return Refusal(reason=RefusalReason.NAME, message=message, expected=["ALL", *known[:20]], clears=by_person(clears))
