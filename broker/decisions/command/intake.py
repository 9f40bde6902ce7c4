"""Intake of a command: from its parsed record to its first claim, in the order of its client's commands. Pure."""

from __future__ import annotations

from typing import Any

import msgspec

from broker.decisions.command import loading, operator_answers
from broker.decisions.command.claims import claim_and_elaborate
from broker.decisions.command.control import concerns_earlier, control
from broker.decisions.command.dependencies import wait_for_another
from broker.decisions.command.rehearsal import rehearse, why_not_as_tested
from broker.decisions.command.termination import refuse
from broker.decisions.context import DecisionContext
from broker.decisions.state import Command, ParsedHead
from rtc.protocol import wire
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import Refusal, RefusalReason

LAST = "LAST"  # stands for the number of the client's previous command that does or states something
ASIDE = frozenset(("HALT", "PAUSE", "RESUME", "ABORT", "SHOW", "QUERY", "DESCRIBE", "TEST"))  # first words of others


read_parsed = wire.decoder(ParsedHead)


def on_parsed(context: DecisionContext, command: Command, product: msgspec.Raw) -> None:
    command.parsed = product
    command.head = head = _with_last(read_parsed(product), command.previous)
    if head.test:  # checked first: TEST HALT must not halt
        rehearse(context, command, head)
    elif refusal := _broker_refusal(command, head) or (
        why_not_as_tested(context, command) if command.if_tested else None
    ):
        refuse(context, command, refusal)
    elif context.is_next(command) or (head.kind == "control" and not concerns_earlier(head)):
        take_up(context, command)
    else:
        context.state.intake_order[command.client][command.id] = True


def may_be_last(text: str) -> bool:
    """Whether LAST may stand for this sentence: control of other commands and questions come between two tasks."""
    words = text.split(maxsplit=1)
    return not words or words[0].upper() not in ASIDE


def _with_last(head: ParsedHead, previous: str) -> ParsedHead:
    """Replace LAST by the number of the client's previous command."""
    if previous and head.after == LAST:
        return msgspec.structs.replace(head, after=previous)
    if previous and head.together_with == LAST:
        return msgspec.structs.replace(head, together_with=previous)
    return head


def _broker_refusal(command: Command, head: ParsedHead) -> Refusal | None:
    """Refuse what only the broker can check: LAST without a previous command, REPORT EVERY without a reader, a test
    that does not cover the sentence."""
    if command.after_test:
        message = "only a TEST sentence can be done in the world after a test"
        return Refusal(
            reason=RefusalReason.STATE,
            message=message,
            where=command.after_test,
            clears=by_person("put TEST before it"),
        )
    if LAST in (head.after, head.together_with):
        word = "AFTER" if head.after else "TOGETHER-WITH"
        own = "each `rtc do` is a client of its own"
        message = f"{word} {LAST}: this client has given no command before this one; {own}"
        clears = f"both sentences in one `rtc do`; or the number: {word} C-n (`rtc log` lists the commands)"
        return Refusal(reason=RefusalReason.NAME, message=message, where=LAST, clears=by_person(clears))
    if head.report is not None and (word := head.report.in_motion) and not command.progress:
        message = f"REPORT {word}: this client does not take progress notes, so the reports would not be delivered"
        clears = f"wait for the command (rtc do without --no-wait; on_progress in Python), or leave out {word}"
        return Refusal(reason=RefusalReason.STATE, message=message, where=word, clears=by_person(clears))
    return None


def take_up(context: DecisionContext, command: Command, _: Any = None) -> None:
    """Start the command after parsing. The commands of one client are taken up in the order given, not in the order in
    which they are parsed. So the first of two commands for one arm is first in line."""
    assert command.head is not None
    if command.head.kind == "control":
        control(context, command, command.head)
    elif command.head.verb in operator_answers.ANSWERS:
        operator_answers.answer(context, command, command.head)
    elif wait_for_another(context, command, command.head):
        return
    elif command.head.kind == "data" and command.head.verb == loading.LOAD:
        loading.load(context, command, command.head)
    else:
        claim_and_elaborate(context, command)
