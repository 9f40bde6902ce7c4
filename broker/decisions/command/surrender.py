"""Surrender (R81): a command has failed, its trims are used up, and the operator is asked to do the same. Pure.

Its arms rest where they are. Commands that were to follow it, and those that wait in line for one of its arms, are held
outside the line: until the operator has done it, or until RESUME or ABORT of each. Later sentences are free to use the
arms, that of the operator first of all.
"""

from __future__ import annotations

from broker.decisions.context import DecisionContext
from broker.decisions.events import Stimulus
from broker.decisions.state import Command, PendingOutcome, Surrender
from rtc.protocol.messages import NoteKind, Phase


def surrender(context: DecisionContext, command: Command, ending: PendingOutcome) -> list[str]:
    """Hold what waits for a command that has moved an arm, if the operator is asked. Returns the commands that can be
    granted now."""
    state, refusal = context.state, ending.refusal
    sentence = refusal.by_operator if refusal is not None and command.primitives else ""
    if not sentence or not (arms := _arms(context, command)):
        return []
    held: list[str] = [name for other in _of_arms(context, arms) for name in state.surrenders.pop(other).waiting]
    granted: list[str] = []
    in_line = [name for name, claim in state.resources.waiting.items() if any(claim.get(arm) for arm in arms)]
    for name in in_line:
        granted += state.resources.release(name)
    held += [*in_line, *state.awaiting.pop(command.id, [])]
    held = [name for name in held if name in state.commands]
    state.surrenders[command.id] = Surrender(arms=arms, cause=ending.message, sentence=sentence)
    for name in held:
        hold(context, state.commands[name], command.id)
    return [name for name in granted if name not in in_line]


def hold(context: DecisionContext, command: Command, failed: str) -> None:
    """Hold a command until the operator has done what another one has failed to do."""
    context.state.surrenders[failed].waiting.append(command.id)
    context.enter(command, Phase.HELD, NoteKind.SURRENDERED, owner=failed, clears=[f"RESUME {command.id}"])


def resume_held(context: DecisionContext, command: Command) -> None:
    """A command has succeeded: what waits for its arms goes on if the operator has performed it."""
    for name in _of_arms(context, _arms(context, command)):
        waiting = context.state.surrenders[name].waiting
        if command.operated or not any(is_held(context, other) for other in waiting):
            del context.state.surrenders[name]
            for other in waiting:
                context.enqueue_stimulus(other, Stimulus.RELEASE, True)


def is_held(context: DecisionContext, name: str) -> bool:
    """Whether a command waits for the operator."""
    found = context.state.commands.get(name)
    held = any(name in one.waiting for one in context.state.surrenders.values())
    return held and found is not None and found.phase is Phase.HELD


def release(context: DecisionContext, name: str) -> None:
    """A command no longer waits for the operator."""
    for one in context.state.surrenders.values():
        if name in one.waiting:
            one.waiting.remove(name)


def _arms(context: DecisionContext, command: Command) -> list[str]:
    """What a command holds alone and a subsystem moves."""
    moved = {name for subsystem in context.state.subsystems.values() for name in subsystem.performers}
    held = context.state.resources.held.get(command.id, {})
    return [name for name, alone in held.items() if alone and name in moved]


def _of_arms(context: DecisionContext, arms: list[str]) -> list[str]:
    return [name for name, one in context.state.surrenders.items() if set(one.arms) & set(arms)]
