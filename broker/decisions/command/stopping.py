"""The halt of a command's primitive: ordered, then confirmed by its end report, by rest, or not at all. Pure.

A command that moves a subsystem ends only after that subsystem is at rest (HALTING) or given up.
"""

from __future__ import annotations

from typing import Any

from broker.decisions.command.closing import WHEN_BACK, close, stop_after_analysis
from broker.decisions.command.limits import await_rest, rest_limit_s
from broker.decisions.command.termination import stop
from broker.decisions.context import DecisionContext
from broker.decisions.effects import AcknowledgeReport, SendHalt
from broker.decisions.state import NIL, Command, PendingOutcome
from rtc.protocol.advice import Advice, again_after
from rtc.protocol.messages import EndReport, HaltOrder, NoteKind, Phase
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason, StopReason

STOP = "stop-"  # prefix of the halt that stops a command's primitive; the command's number follows


RETRY_ADVICE = again_after(WHEN_BACK)
UNCONFIRMED_ADVICE = again_after("look whether the arm rests, and see in rtc status whether the subsystem is back")


def stop_primitive(context: DecisionContext, command: Command, ending: PendingOutcome) -> None:
    """Halt the primitive that is being executed, and wait for rest."""
    command.pending_outcome = ending
    order_halt(context, command)
    about, message = ending.scope, ending.message
    context.enter(command, Phase.HALTING, NoteKind.STOPPING, about=about, reason=ending.stop, message=message)


def order_halt(context: DecisionContext, command: Command) -> None:
    context.effects.append(
        SendHalt(
            subsystem=command.subsystem,
            order=HaltOrder(halt=f"{STOP}{command.id}", scope=command.id, called_at_s=context.now),
        )
    )
    await_rest(context, command, [command.subsystem])


def stop_overdue(context: DecisionContext, command: Command, _: Any) -> None:
    """Stop a primitive without an end report in time. F always contains a time limit, so the subsystem is at fault."""
    message = f"{command.subsystem} gave no end report within {command.limit_s:.1f} s: it is too slow, or hangs"
    advice = again_after(f"see in rtc status whether {command.subsystem} runs, and whether a fault is injected")
    stop_primitive(context, command, _outcome(OutcomeKind.FAILED, StopReason.TIMEOUT, message, advice))


def on_rested(context: DecisionContext, command: Command, report: EndReport) -> None:
    """Close after the end report. It proves rest whatever its reason: the motion may have ended by itself."""
    context.stop_timer(command)
    command.measured = report.reading or command.measured
    context.effects.append(AcknowledgeReport(subsystem=command.subsystem, primitive=command.primitive))
    command.primitive_body = NIL
    command.at_rest = True
    close(context, command, report, NoteKind.AT_REST, reason=report.reason)


def on_rest_confirmed(context: DecisionContext, command: Command, _: Any) -> None:
    """Close without an end report. A subsystem sends the report before it confirms rest, so without a report it never
    received the primitive."""
    command.at_rest = True
    close(context, command, missing_report(context, command, StopReason.HALT), NoteKind.AT_REST)


def fail_unconfirmed(context: DecisionContext, command: Command, _: Any) -> None:
    limit_s = rest_limit_s(context.state)
    stop_reason = command.pending_outcome.stop if command.pending_outcome else None
    message = _after_cause(command, f"rest was not confirmed by {command.subsystem} within {limit_s:.0f} s")
    over = _outcome(OutcomeKind.HALT_NOT_CONFIRMED, stop_reason or StopReason.HALT, message, UNCONFIRMED_ADVICE)
    command.pending_outcome = over
    close(context, command, missing_report(context, command), NoteKind.NOT_AT_REST, message=message)


def _after_cause(command: Command, message: str) -> str:
    """The message after the reason for which the primitive is being halted."""
    before = command.pending_outcome
    return f"{before.message}; {message}" if before else message


def stop_lost(context: DecisionContext, command: Command, why: str) -> None:
    """End a command whose subsystem is lost while nothing moves for it."""
    stop(context, command, _lost(f"{command.subsystem} was lost: {why}"))


def stop_lost_after_analysis(context: DecisionContext, command: Command, why: str) -> None:
    stop_after_analysis(context, command, _lost(f"{command.subsystem} was lost: {why}"))


def _lost(message: str) -> PendingOutcome:
    return _outcome(OutcomeKind.LOST_SUBSYSTEM, StopReason.SUBSYSTEM_LOST, message, RETRY_ADVICE)


def _outcome(kind: OutcomeKind, stop_reason: StopReason, message: str, advice: Advice) -> PendingOutcome:
    refusal = Refusal(reason=RefusalReason.STATE, message=message, clears=advice)
    return PendingOutcome(kind=kind, message=message, stop=stop_reason, refusal=refusal)


def on_subsystem_lost(context: DecisionContext, command: Command, why: str) -> None:
    message = f"{command.subsystem} was lost while executing: {why}"
    command.pending_outcome = _lost(message)
    command.at_rest = context.state.subsystems[command.subsystem].came_at_rest
    close(context, command, missing_report(context, command), NoteKind.SUBSYSTEM_LOST, message=message)


def on_lost_while_halting(context: DecisionContext, command: Command, why: str) -> None:
    message = _after_cause(command, f"{command.subsystem} was lost before it confirmed rest: {why}")
    stop_reason = StopReason.SUBSYSTEM_LOST
    command.pending_outcome = _outcome(OutcomeKind.HALT_NOT_CONFIRMED, stop_reason, message, UNCONFIRMED_ADVICE)
    command.at_rest = context.state.subsystems[command.subsystem].came_at_rest
    close(context, command, missing_report(context, command), NoteKind.SUBSYSTEM_LOST, message=message)


def missing_report(
    context: DecisionContext, command: Command, reason: StopReason = StopReason.SUBSYSTEM_LOST
) -> EndReport:
    """A substitute for the end report of a lost subsystem: it carries the reason and no measurements."""
    return EndReport(
        primitive=command.primitive,
        performer=command.performers[0],
        reason=reason,
        at_s=context.now,
        duration_s=0.0,
    )
