"""The last analysis of a command whose motion was stopped or lost: it updates the world facts (R138, R151). Pure.

Its verdict is ignored, but not its advice for an arm that was halted or lost, nor its remark on a halt. If it takes too
long, it is deferred and the command ends.
"""

from __future__ import annotations

from typing import Any, Unpack

import msgspec

from broker.decisions import deferred_analysis
from broker.decisions.command.jobs import QUARANTINED, SUSPECT, dispatch_again, has_moved, retry_analysis
from broker.decisions.command.limits import CLOSING_LIMIT_S
from broker.decisions.command.termination import cancel, end
from broker.decisions.context import DecisionContext, NoteFacts
from broker.decisions.events import JobLost
from broker.decisions.state import NIL, AssessmentHead, Command, PendingOutcome
from rtc.protocol import wire
from rtc.protocol.advice import again_after, in_order
from rtc.protocol.messages import AnalyzerInput, EndReport, EvaluationContext, NoteKind, Phase, WorkerKind
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason

WHEN_BACK = "when the subsystem is back"

read_assessment = wire.decoder(AssessmentHead)


def close(
    context: DecisionContext, command: Command, report: EndReport, kind: NoteKind, **facts: Unpack[NoteFacts]
) -> None:
    """Start the last analysis, which only updates the world facts. `kind`, `facts`: of the note that it begins."""
    assert command.actions is not None
    context.stop_timer(command)
    command.primitive_body = NIL
    evaluation = wire.opaque(command.evaluation, EvaluationContext)
    data = AnalyzerInput(evaluation=evaluation, report=report, closing=True)
    context.create_job(command, WorkerKind.ANALYZER, data, locations=command.actions.script.writes)
    context.start_timer(command, CLOSING_LIMIT_S)
    context.enter(command, Phase.CLOSING, kind, **facts)


def stop_after_analysis(context: DecisionContext, command: Command, ending: PendingOutcome) -> None:
    """Let the running analysis update the world facts, and ignore its verdict (R138)."""
    command.pending_outcome = ending
    if command.due_s:  # a retry was scheduled, because the world database was unavailable
        retry_analysis(context, command, None)
    context.start_timer(command, CLOSING_LIMIT_S)
    context.enter(command, Phase.CLOSING, NoteKind.LAST_ANALYSIS, message=ending.message)


def finish_closing(context: DecisionContext, command: Command, product: Any) -> None:
    """End after the last analysis. `product`: its verdict, of which only advice and remark count; or None."""
    assert command.pending_outcome is not None
    context.stop_timer(command)
    cancel(context, command)
    ending = command.pending_outcome
    refusal = ending.refusal
    head = read_assessment(product) if isinstance(product, msgspec.Raw) else None
    clears = head.clears if head is not None else []
    if head is not None and head.remark and ending.kind is OutcomeKind.HALTED:
        ending = msgspec.structs.replace(ending, message=f"{ending.message}; {head.remark}")
    if clears and ending.kind is OutcomeKind.HALTED and refusal is None:
        refusal = Refusal(reason=RefusalReason.STATE, message=ending.message, clears=clears)
    elif clears and ending.kind is OutcomeKind.LOST_SUBSYSTEM and refusal is not None:
        refusal = msgspec.structs.replace(refusal, clears=in_order(clears, again_after(WHEN_BACK)))
    end(context, command, msgspec.structs.replace(ending, refusal=refusal))


def retry_last_analysis(context: DecisionContext, command: Command, loss: JobLost) -> None:
    """Dispatch the lost last analysis again; end without it if the job is poison."""
    if dispatch_again(context, command, loss):
        give_up_closing_analysis(context, command, None)


def give_up_closing_analysis(context: DecisionContext, command: Command, _: Any) -> None:
    """End without the last analysis: it was refused, or is poison. The facts become suspect first."""
    if not has_moved(command):
        finish_closing(context, command, None)
        return
    _end_deferred(context, command, SUSPECT)
    deferred_analysis.on_given_up(context, command.id)


def defer_closing_analysis(context: DecisionContext, command: Command, refusal: Refusal | None) -> None:
    """Defer the last analysis and end the command. `refusal`: the world database is unavailable; None: time limit."""
    _end_deferred(context, command, QUARANTINED)
    if refusal is not None:
        deferred_analysis.on_unavailable(context, command.id)


def _end_deferred(context: DecisionContext, command: Command, consequence: str) -> None:
    assert command.pending_outcome is not None
    context.stop_timer(command)
    message = f"{command.pending_outcome.message}; {consequence}"
    end(context, command, msgspec.structs.replace(command.pending_outcome, message=message), defer_analysis=True)
