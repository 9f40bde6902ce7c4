"""The end of a command: `end` releases its resources and reports its outcome; it is the only way to ENDED. Pure.

A command has no effects after its end, except a deferred analysis.
"""

from __future__ import annotations

from itertools import islice

import msgspec

from broker.decisions import deferred_analysis
from broker.decisions.command import advised, surrender
from broker.decisions.context import DecisionContext
from broker.decisions.effects import CancelJob, ReportEnd
from broker.decisions.events import Stimulus
from broker.decisions.resources import Quarantine
from broker.decisions.state import Command, PendingOutcome, Result, request_key
from rtc.protocol import wire
from rtc.protocol.advice import by_person
from rtc.protocol.messages import CommandEnded, CommandRecord, NoteKind, Phase
from rtc.protocol.outcomes import Compared, Outcome, OutcomeKind, Refusal, RefusalReason

ENDED_KEPT = 4096  # minimum number of stored results, for clients that ask again
FORGOTTEN_AT_ONCE = 512  # results deleted together: the search for a dict's oldest key slows down with deletions
UNCONFIRMED = (OutcomeKind.HALT_NOT_CONFIRMED, OutcomeKind.LOST_SUBSYSTEM)


def end(
    context: DecisionContext,
    command: Command,
    ending: PendingOutcome,
    *,
    defer_analysis: bool = False,
    compared: Compared | None = None,
) -> None:
    """End a command: release its resources and report its outcome. This is the only way to ENDED.

    `defer_analysis`: the last analysis continues after the command has ended; the names it will write stay quarantined.
    `compared`: of the step that has failed.
    """
    state, kind = context.state, ending.kind
    if kind is OutcomeKind.SUCCEEDED or ending.refusal is not None:
        ending = msgspec.structs.replace(ending, refusal=advised.judged(state, command, kind, ending.refusal))
    succeeded = kind is OutcomeKind.SUCCEEDED
    outcome = Outcome(
        kind=kind,
        message=ending.message,
        stop=ending.stop,
        refusal=ending.refusal,
        step="" if succeeded else command.step_words,
        trims=[*command.actions.trim_labels] if command.actions else [],
        steps_done=command.steps_done,
        measured=command.measured,
        rehearsal=ending.rehearsal,
    )
    if defer_analysis:
        deferred_analysis.defer(context, command)
    command.job = None
    surrendered = surrender.surrender(context, command, ending) if ending.refusal is not None else []
    if state.surrenders:
        if succeeded:
            surrender.resume_held(context, command)
        surrender.release(context, command.id)
    context.enter(command, Phase.ENDED, NoteKind.OUTCOME, outcome=kind, message=ending.message, compared=compared)
    doubt = kind in UNCONFIRMED and not command.at_rest
    in_doubt = Quarantine(command.subsystem, command.primitive) if doubt else None
    granted = state.resources.release(command.id, in_doubt, command.performers)
    if state.space_lines:
        context.leave_space_line(command)
        context.check_space_lines()
    if command.operated:
        settle_answers(context, command.primitive, f"{command.id} has ended before the answer", "")
    for waiting in state.awaiting.pop(command.id, ()):
        context.enqueue_stimulus(waiting, Stimulus.RELEASE, succeeded)
    for waiting in state.joining.pop(command.id, ()):
        context.enqueue_stimulus(waiting, Stimulus.RELEASE, False)
    context.grant([*surrendered, *granted])  # last, so that commands that came AFTER it precede those given later
    context.count(kind)
    ended = _report_end(context, command, outcome)
    del state.commands[command.id]
    state.live[command.client] -= 1
    if not state.live[command.client]:
        del state.live[command.client]
    _remember(context, command, ended, succeeded)
    if state.motions:
        context.forget_motions()


def _report_end(context: DecisionContext, command: Command, outcome: Outcome) -> CommandEnded:
    """Send the outcome and the record of a command."""
    context.state.seq += 1
    ended = CommandEnded(
        seq=context.state.seq,
        at_s=context.now,
        command=command.id,
        request=command.request,
        text=command.text,
        outcome=outcome,
        took_s=context.now - command.accepted_at_s,
    )
    record = CommandRecord(
        command=command.id,
        text=command.text,
        source=command.source,
        request=command.request,
        accepted_at_s=command.accepted_at_s,
        phase=command.phase,
        notes=command.notes,
        outcome=outcome,
        ended_at_s=context.now,
        case=command.case,
    )
    context.effects.append(ReportEnd(client=command.client, ended=ended, record=record))
    return ended


def _remember(context: DecisionContext, command: Command, ended: CommandEnded, succeeded: bool) -> None:
    """Store the result for a client that asks again, and delete the oldest ones."""
    state = context.state
    state.ended[command.id] = Result(wire.raw(ended), succeeded, request_key(command.client, command.request))
    if len(state.ended) < ENDED_KEPT + FORGOTTEN_AT_ONCE:
        return
    for oldest in list(islice(state.ended, FORGOTTEN_AT_ONCE)):
        del state.requests[state.ended.pop(oldest).request]


def refuse(context: DecisionContext, command: Command, refusal: Refusal) -> None:
    if command.given_up is not None:
        end_given_up(context, command, refusal.message)
        return
    end(context, command, PendingOutcome(OutcomeKind.REFUSED, refusal.message, refusal=refusal))


def end_given_up(context: DecisionContext, command: Command, after: str = "") -> None:
    """End with the cause of the give-up. `after`: message of a later failure."""
    cause = command.given_up
    assert cause is not None
    if after:
        cause = msgspec.structs.replace(cause, message=f"{cause.message}; after that: {after}")
    end(context, command, cause)


def stop(context: DecisionContext, command: Command, ending: PendingOutcome) -> None:
    """End a command for which nothing moves. A result that is still under way becomes stale."""
    cancel(context, command)
    end(context, command, ending)


def cancel(context: DecisionContext, command: Command) -> None:
    if command.job is not None:
        context.effects.append(CancelJob(job=command.job.id))
        command.job = None


def settle_answers(context: DecisionContext, primitive: str, refused: str, words: str) -> None:
    """End the commands of the answers of the operator to a primitive: they have succeeded, or `refused` states why not.
    What they are about goes on then."""
    answers = context.state.answers
    for name in [name for name, message in answers.items() if message.primitive == primitive]:
        del answers[name]
        ending = PendingOutcome(OutcomeKind.SUCCEEDED, words)
        if refused:
            clears = "do what is missing, then DONE again; or CANNOT and the reason; rtc operator shows the request"
            why = Refusal(reason=RefusalReason.STATE, message=refused, clears=by_person(clears))
            ending = PendingOutcome(OutcomeKind.REFUSED, refused, refusal=why)
        context.enqueue_stimulus(name, Stimulus.RELEASE, ending)
