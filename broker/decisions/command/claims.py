"""Claims of a command: the names in its sentence before it is planned, then all names of its plan. Pure."""

from __future__ import annotations

from typing import Any

from broker.decisions.command.termination import refuse
from broker.decisions.context import DecisionContext
from broker.decisions.resources import Claim
from broker.decisions.state import Command, ParsedHead, exact_arms_of
from rtc.protocol import wire
from rtc.protocol.advice import Advice, by_person, by_sentence
from rtc.protocol.messages import ElaboratorInput, NoteKind, Phase, WorkerKind
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.sentence import BOTH_ARMS, ParsedCommand

MAX_ELABORATIONS = 20  # maximum per command, if its claim changes with each elaboration


def _named(context: DecisionContext, head: ParsedHead) -> Claim:
    """The claim of the names in the sentence: hands exclusively, the object shared against changes by others."""
    claim: Claim = {}
    if head.kind == "task":
        if head.object:
            claim[head.object] = False
        for hand in (head.hand, head.to_hand):
            if hand == BOTH_ARMS:
                performers = (p for s in context.state.subsystems.values() for p in s.performers if p not in s.queues)
                claim.update(dict.fromkeys(performers, True))
            elif hand:
                claim[hand] = True
    return claim


def claim_and_elaborate(context: DecisionContext, command: Command) -> None:
    """Claim the named resources, then elaborate, so that no other command changes the facts of the plan."""
    assert command.head is not None
    if claim_or_wait(context, command, _named(context, command.head)):
        elaborate(context, command)


def claim_or_wait(context: DecisionContext, command: Command, claim: Claim) -> bool:
    """True: the claim is granted. False: the command waits in line, or was refused because of NOW."""
    assert command.head is not None
    resources = context.state.resources
    result = resources.take(command.id, claim)
    if context.state.space_lines:
        context.check_space_lines()
    if isinstance(result, list):
        context.grant(result)
        return True
    name, owner = result
    if command.head.now:
        message = f"{name} is in use by {owner}, and the sentence contains NOW"
        clears = without_now(owner)
        refuse(context, command, Refusal(reason=RefusalReason.RESOURCE, message=message, owner=owner, clears=clears))
        return False
    context.grant(resources.wait(command.id, claim))
    context.check_space_lines()
    _hold(context, command, name, owner)
    return False


def _hold(context: DecisionContext, command: Command, name: str, owner: str) -> None:
    """Note what it waits for, and what ends a use that does not end by itself: that of a paused command, and of an
    operator, who may have left."""
    other = context.state.commands.get(owner)
    kind, arm, clears = NoteKind.IN_USE, "", list[str]()
    if other is not None and (other.pause_wanted or other.phase is Phase.PAUSED):
        kind, clears = NoteKind.IN_USE_PAUSED, [f"RESUME {owner}", f"ABORT {owner}"]
    elif other is not None and other.operated:
        arm = other.performers[0]
        kind, clears = NoteKind.IN_USE_OPERATOR, [f"TAKE {arm} FROM OPERATOR"]
    context.enter(command, Phase.HELD, kind, about=name, owner=owner, arm=arm, clears=clears)


def on_granted(context: DecisionContext, command: Command, _: Any) -> None:
    """Take the granted claim and elaborate again, because the world may have changed during the wait."""
    resources = context.state.resources
    result = resources.take(command.id, resources.waiting.get(command.id, {}))
    if isinstance(result, list):
        context.grant(result)
        elaborate(context, command)


def elaborate(context: DecisionContext, command: Command) -> None:
    """Elaborate with the granted claim. The number of times is limited."""
    command.elaborations += 1
    if command.elaborations > MAX_ELABORATIONS:
        message = f"its claim changed {MAX_ELABORATIONS} times while it waited for it"
        refuse(context, command, Refusal(reason=RefusalReason.OVERLOAD, message=message))
        return
    start_elaboration(context, command)


def start_elaboration(context: DecisionContext, command: Command) -> None:
    of_facts = command.head is not None and command.head.kind == "data"
    holders = context.state.resources.holders if of_facts else {}
    data = ElaboratorInput(
        command=command.id,
        parsed=wire.opaque(command.parsed, ParsedCommand),
        moving=context.motions_beside(command),
        owners={name: ", ".join(users) for name, users in holders.items()},
        rests_on=command.rests_on,
        saved=command.saved,
        rigid=exact_arms_of(context.state),
    )
    context.create_job(command, WorkerKind.ELABORATOR, data)
    context.enter(command, Phase.ELABORATING)


def without_now(owner: str) -> Advice:
    """What helps a sentence with NOW that needs what `owner` has."""
    return [*by_person("leave out NOW", f"wait for {owner}"), *by_sentence(f"ABORT {owner}")]
