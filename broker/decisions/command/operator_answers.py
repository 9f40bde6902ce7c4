"""DONE, CANNOT and TAKE: answers of the operator to a request. Pure.

An answer is passed on to the subsystem of the primitive, which knows where the arm is. The command of the answer waits
for the end report of that primitive, or for the refusal of a DONE.
"""

from __future__ import annotations

from broker.decisions.command.termination import refuse, settle_answers
from broker.decisions.context import DecisionContext
from broker.decisions.effects import SendAnswer
from broker.decisions.events import AnswerWasRefused
from broker.decisions.state import Command, LinkState, ParsedHead
from rtc.protocol.advice import again_after, by_person, by_sentence
from rtc.protocol.messages import EndReport, NoteKind, OperatorAnswer, Phase
from rtc.protocol.outcomes import OF_OPERATOR, Refusal, RefusalReason
from rtc.protocol.primitive_id import command_of

TAKE, CANNOT, GIVE = "TAKE", "CANNOT", "GIVE"
ANSWERS = ("DONE", CANNOT, TAKE)


def answer(context: DecisionContext, command: Command, head: ParsedHead) -> None:
    """Pass the answer on to the one command that it is about, or refuse it."""
    asked = [c for c in context.state.commands.values() if c.operated and c.phase is Phase.EXECUTING]
    if head.verb == TAKE:
        asked = [c for c in asked if head.hand in c.performers]
    if len(asked) != 1:
        coming = None if asked or head.verb != TAKE else _coming(context, head.hand)
        refuse(context, command, _not_yet(head, coming) if coming else _not_one(head, asked))
        return
    (target,) = asked
    given_back = head.verb == TAKE and target.head is not None and target.head.verb == GIVE
    why = f"taken back by {command.id}" if head.verb == TAKE else head.reason or ""
    done = given_back or head.verb not in (TAKE, CANNOT)
    message = OperatorAnswer(primitive=target.primitive, done=done, why="" if done else why)
    context.state.answers[command.id] = message
    context.enter(command, Phase.HELD, NoteKind.ANSWERING, owner=target.id)
    send(context, target, message)


def send(context: DecisionContext, target: Command, message: OperatorAnswer) -> None:
    """Send an answer; an awaited subsystem gets it when it connects."""
    if context.state.subsystems[target.subsystem].link is LinkState.CONNECTED:
        context.effects.append(SendAnswer(subsystem=target.subsystem, answer=message))


def _coming(context: DecisionContext, arm: str | None) -> Command | None:
    """The command that will hand this arm to the operator, but has not done so yet."""
    for command in context.state.commands.values():
        if command.head is not None and (command.head.verb, command.head.hand) == (GIVE, arm):
            return command
    return None


def _not_yet(head: ParsedHead, coming: Command) -> Refusal:
    """A GIVE that still waits, or is being bound: TAKE would end it before the operator has had the arm."""
    clears = [
        *by_sentence(f"ABORT {coming.id}", instead=True),
        *again_after(f"once {coming.id} has handed {head.hand} over"),
    ]
    message = f"{coming.id} has not handed {head.hand} to the operator yet"
    return Refusal(reason=RefusalReason.STATE, message=message, where=head.verb, clears=clears)


def _not_one(head: ParsedHead, asked: list[Command]) -> Refusal:
    if asked:
        which = " or ".join(f"{c.id} ({', '.join(c.performers)})" for c in asked)
        arm = asked[0].performers[0]
        message, clears = f"{head.verb} may be about {which}", by_sentence(f"TAKE {arm} FROM OPERATOR")
    else:
        what = f"the operator does not have {head.hand}" if head.verb == TAKE else "no command waits for the operator"
        message = f"{what} now"
        words = f"GIVE {head.hand or 'an arm'} TO OPERATOR, or a sentence VIA OPERATOR-INTERVENTION, comes before it"
        clears = by_person(words)
    return Refusal(reason=RefusalReason.STATE, message=message, where=head.verb, clears=clears)


def on_reported(context: DecisionContext, report: EndReport) -> None:
    """Settle the answers to a primitive that has ended."""
    if not context.state.answers:  # the usual case
        return
    step = f"the operator's step of {command_of(report.primitive)}"
    if report.reason in OF_OPERATOR:
        settle_answers(context, report.primitive, "", f"{step} is over")
    else:
        why = report.reason.value.replace("_", " ") + (f": {report.message}" if report.message else "")
        words = f"{step} ended before the answer ({why})"
        settle_answers(context, report.primitive, words, words)


def on_refused(context: DecisionContext, event: AnswerWasRefused) -> None:
    """A DONE that the measurements do not prove: what it is about goes on."""
    settle_answers(context, event.primitive, event.message, "")
