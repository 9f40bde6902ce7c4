"""Termination of commands: actions of `broker.decisions.transitions` for refusals, losses, halts and the last analysis.

Rule 1: a command that moves a subsystem ends only after that subsystem is at rest (HALTING) or given up. Rule 2: one
last analysis corrects the world facts the command touched; its verdict is ignored (CLOSING, R138, R151). Rule 3: `end`
is the only way to ENDED, and a command has no effects after it, except a deferred analysis.
"""

from __future__ import annotations

from itertools import islice
from typing import Any

from broker.decisions import deferred_analysis, reporting
from broker.decisions.context import DecisionContext
from broker.decisions.effects import AcknowledgeReport, CancelJob, ReportEnd, SendHalt
from broker.decisions.events import Stimulus
from broker.decisions.resources import Quarantine
from broker.decisions.state import NIL, Command, PendingOutcome, Result, State, request_key
from rtc.protocol import wire
from rtc.protocol.messages import CommandEnded, CommandRecord, EndReport, Phase, WorkerKind
from rtc.protocol.outcomes import Outcome, OutcomeKind, Refusal, RefusalReason, StopReason

HALT_LIMIT_S = 2.0  # time limit for a subsystem to confirm rest, at real-time speed
REPORT_MARGIN_S = 2.0  # added where a late message, or a subsystem that must reconnect, is not yet a fault
CLOSING_LIMIT_S = 10.0  # time limit for the last analysis; then it is deferred and the command ends
STOP = "stop-"  # prefix of the halt that stops a command's primitive; the command's number follows
ENDED_KEPT = 4096  # minimum number of stored results, for clients that ask again
FORGOTTEN_AT_ONCE = 512  # results deleted together: the search for a dict's oldest key slows down with deletions

QUARANTINED = "the names it touched stay quarantined until the world database is updated"

RETRY_ADVICE = "give the sentence again when the subsystem is back: the arm's position is read first"

UNCONFIRMED = (OutcomeKind.HALT_NOT_CONFIRMED, OutcomeKind.LOST_SUBSYSTEM)


def rest_limit_s(state: State, *, reconnecting: bool = False) -> float:
    """Time limit in seconds for a confirmation of rest. It is the same for every kind of halt.

    `reconnecting`: the broker has just restarted, so the subsystem must connect to it first.
    """
    return HALT_LIMIT_S * max(1.0, state.timeout_scale) + (REPORT_MARGIN_S if reconnecting else 0.0)


def report_limit_s(state: State, command: Command) -> float:
    """Time limit in seconds for the end report of the command's primitive."""
    return command.limit_s * state.timeout_scale + REPORT_MARGIN_S


def end(
    context: DecisionContext,
    command: Command,
    kind: OutcomeKind,
    *,
    message: str = "",
    stop: StopReason | None = None,
    refusal: Refusal | None = None,
    defer_analysis: bool = False,
) -> None:
    """End a command: release its resources and report its outcome. This is the only way to ENDED.

    `defer_analysis`: the last analysis continues after the command has ended; the names it will write stay quarantined.
    """
    state = context.state
    outcome = Outcome(
        kind=kind,
        message=message,
        stop=stop,
        refusal=refusal,
        step=command.step_words if kind is not OutcomeKind.SUCCEEDED else "",
        trims=command.actions.trim_labels if command.actions else [],
        steps_done=command.steps_done,
        measured=command.measured,
    )
    if defer_analysis:
        deferred_analysis.defer(context, command)
    command.job = None
    context.enter(command, Phase.ENDED, f"{kind.value}{': ' + message if message else ''}")
    in_doubt = Quarantine(command.subsystem, command.primitive) if _in_doubt(command, kind) else None
    granted = state.resources.release(command.id, in_doubt, frozenset(command.performers))
    for waiting in state.awaiting.pop(command.id, ()):
        context.follow(waiting, Stimulus.RELEASE, kind is OutcomeKind.SUCCEEDED)
    for waiting in state.joining.pop(command.id, ()):
        context.follow(waiting, Stimulus.RELEASE, False)
    context.grant(granted)  # last, so that commands that came AFTER it precede those given later
    context.count(kind.value)
    state.seq += 1
    ended = CommandEnded(
        seq=state.seq,
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
        phase=Phase.ENDED,
        notes=command.notes,
        outcome=outcome,
        ended_at_s=context.now,
    )
    context.effects.append(ReportEnd(client=command.client, ended=ended, record=record))
    del state.commands[command.id]
    state.live[command.client] -= 1
    if not state.live[command.client]:
        del state.live[command.client]
    _remember(context, command, ended)


def _in_doubt(command: Command, kind: OutcomeKind) -> bool:
    return kind in UNCONFIRMED and not command.at_rest


def _remember(context: DecisionContext, command: Command, ended: CommandEnded) -> None:
    """Store the result for a client that asks again, and delete the oldest ones."""
    state = context.state
    succeeded = ended.outcome.kind is OutcomeKind.SUCCEEDED
    state.ended[command.id] = Result(wire.raw(ended), succeeded, request_key(command.client, command.request))
    if len(state.ended) < ENDED_KEPT + FORGOTTEN_AT_ONCE:
        return
    for oldest in list(islice(state.ended, FORGOTTEN_AT_ONCE)):
        del state.requests[state.ended.pop(oldest).request]


# --- refused -----------------------------------------------------------------------------------------


def refuse(context: DecisionContext, command: Command, refusal: Refusal) -> None:
    if command.given_up is not None:
        end_given_up(context, command, refusal.message)
        return
    end(context, command, OutcomeKind.REFUSED, message=refusal.message, refusal=refusal)


def end_given_up(context: DecisionContext, command: Command, after: str = "") -> None:
    """End with the cause of the give-up. `after`: message of a later failure."""
    cause = command.given_up
    assert cause is not None
    message = f"{cause.message}; after that: {after}" if after else cause.message
    end(context, command, cause.kind, message=message, stop=cause.stop, refusal=cause.refusal)


# --- the world database unavailable ----------------------------------------------------------------------------------


def fail_unavailable(context: DecisionContext, command: Command, refusal: Refusal) -> None:
    """A job before a motion could not be done: refused before the first primitive, failed after it."""
    if command.primitives:
        end(context, command, OutcomeKind.FAILED, message=refusal.message, refusal=refusal)
    else:
        refuse(context, command, refusal)


def schedule_analysis_retry(context: DecisionContext, command: Command, refusal: Refusal) -> None:
    """Repeat an analysis while the world database is unavailable; after LIMIT_S defer it and end the command."""
    job = command.job
    assert job is not None
    job.attempt += 1  # a late answer to the previous attempt is stale
    if context.now - job.since_s <= deferred_analysis.LIMIT_S:
        context.count("analyses_again")
        context.start_timer(command, deferred_analysis.AGAIN_S)
        context.note(command, f"{refusal.message}; the analysis is repeated")
        return
    message = (
        f"the result could not be analysed within {deferred_analysis.LIMIT_S:.0f} s: {refusal.message}; {QUARANTINED}"
    )
    refusal = Refusal(reason=refusal.reason, message=message, clears="wait until the world database is back")
    end(context, command, OutcomeKind.FAILED, message=message, refusal=refusal, defer_analysis=True)
    deferred_analysis.schedule_retry(context, command.id)


def retry_analysis(context: DecisionContext, command: Command, _: Any) -> None:
    assert command.job is not None
    context.dispatch(command.job)


# --- a worker lost -----------------------------------------------------------------------------------


def retry_job(context: DecisionContext, command: Command, loss: Any) -> None:
    """Dispatch the job again: jobs are stateless. A job that was in progress at three worker deaths is poison."""
    job = command.job
    assert job is not None
    if loss.blamed:
        job.deaths.append(f"{loss.node}: {loss.evidence}")
    if len(job.deaths) < deferred_analysis.MAX_DEATHS:
        job.attempt += 1
        context.count("jobs_again")
        context.note(
            command, f"{loss.node} lost ({loss.evidence.splitlines()[-1] if loss.evidence else 'gone'}); job again"
        )
        context.dispatch(job)
        return
    message = f"the {job.kind.value}'s job {job.id} killed its worker {len(job.deaths)} times"
    refusal = Refusal(
        reason=RefusalReason.POISON,
        message=message,
        where=command.step_words,
        clears="the evidence is in the trace; change the sentence or the program",
        detail={f"death {n}": evidence[-800:] for n, evidence in enumerate(job.deaths, 1)},
    )
    if command.phase is Phase.CLOSING:
        finish_closing(context, command, None)
    elif command.phase is Phase.ANALYZING:
        end(context, command, OutcomeKind.FAILED, message=message, refusal=refusal)
    else:
        refuse(context, command, refusal)


# --- stopped -----------------------------------------------------------------------------------------


def stop(context: DecisionContext, command: Command, ending: PendingOutcome) -> None:
    """End a command for which nothing moves. A result that is still under way becomes stale."""
    cancel(context, command)
    end(context, command, ending.kind, message=ending.message, stop=ending.stop)


def cancel(context: DecisionContext, command: Command) -> None:
    if command.job is not None:
        context.effects.append(CancelJob(job=command.job.id))
        command.job = None


def stop_primitive(context: DecisionContext, command: Command, ending: PendingOutcome) -> None:
    """Halt the primitive that is being executed, and wait for rest."""
    command.pending_outcome = ending
    order_halt(context, command)
    context.enter(command, Phase.HALTING, ending.message)


def order_halt(context: DecisionContext, command: Command) -> None:
    context.effects.append(
        SendHalt(subsystem=command.subsystem, halt=f"{STOP}{command.id}", scope=command.id, called_at_s=context.now)
    )
    context.start_timer(command, rest_limit_s(context.state))


def stop_overdue(context: DecisionContext, command: Command, _: Any) -> None:
    """Stop a primitive without an end report in time. F always contains a time limit, so the subsystem is at fault."""
    message = f"{command.subsystem} gave no end report within {command.limit_s:.1f} s"
    stop_primitive(context, command, PendingOutcome(kind=OutcomeKind.FAILED, message=message, stop=StopReason.TIMEOUT))


def on_rested(context: DecisionContext, command: Command, report: EndReport) -> None:
    """Close after the end report. It proves rest whatever its reason: the motion may have ended by itself."""
    context.stop_timer(command)
    command.measured = reporting.at_end(command, report)
    context.effects.append(AcknowledgeReport(subsystem=command.subsystem, primitive=command.primitive))
    command.primitive_body = NIL
    command.at_rest = True
    close(context, command, report, f"at rest: {report.reason.value}")


def on_rest_confirmed(context: DecisionContext, command: Command, at_rest: bool) -> None:
    """Handle a confirmation of rest, for a HALT sentence or for the halt of this command's primitive.

    A HALT sentence ends when all subsystems in its scope have confirmed. A subsystem sends the end report before it
    confirms rest. Without an end report it never received the primitive.
    """
    assert command.pending_outcome is not None
    if command.primitive:
        if at_rest:
            command.at_rest = True
            close(context, command, missing_report(context, command, StopReason.HALT), "at rest: it had not begun")
        return
    if context.node not in command.unconfirmed:
        return  # a duplicate, or a subsystem outside the scope
    command.unconfirmed.remove(context.node)
    if not at_rest:
        context.stop_timer(command)
        end(context, command, OutcomeKind.HALT_NOT_CONFIRMED, message=f"{context.node} is not at rest")
    elif not command.unconfirmed:
        context.stop_timer(command)
        end(context, command, command.pending_outcome.kind, message=command.pending_outcome.message)


def fail_unconfirmed(context: DecisionContext, command: Command, _: Any) -> None:
    who = command.subsystem or ", ".join(command.unconfirmed) or "any subsystem"
    message = f"halted, but rest was not confirmed by {who} within {rest_limit_s(context.state):.0f} s"
    command.pending_outcome = PendingOutcome(kind=OutcomeKind.HALT_NOT_CONFIRMED, message=message, stop=StopReason.HALT)
    if command.primitive:
        close(context, command, missing_report(context, command), message)
    else:  # a HALT sentence: it touched nothing
        end(context, command, OutcomeKind.HALT_NOT_CONFIRMED, message=message, stop=StopReason.HALT)


# --- a subsystem lost --------------------------------------------------------------------------------


def on_subsystem_lost(context: DecisionContext, command: Command, why: str) -> None:
    message = f"{command.subsystem} was lost while executing: {why}"
    command.pending_outcome = PendingOutcome(
        kind=OutcomeKind.LOST_SUBSYSTEM,
        message=message,
        stop=StopReason.SUBSYSTEM_LOST,
        refusal=Refusal(reason=RefusalReason.STATE, message=message, clears=RETRY_ADVICE),
    )
    command.at_rest = context.state.subsystems[command.subsystem].came_at_rest
    close(context, command, missing_report(context, command), message)


def on_lost_while_halting(context: DecisionContext, command: Command, why: str) -> None:
    who = command.subsystem or "a subsystem"
    message = f"{who} was lost before it confirmed rest: {why}"
    command.pending_outcome = PendingOutcome(
        kind=OutcomeKind.HALT_NOT_CONFIRMED, message=message, stop=StopReason.SUBSYSTEM_LOST
    )
    if command.primitive:
        command.at_rest = context.state.subsystems[command.subsystem].came_at_rest
        close(context, command, missing_report(context, command), message)
    else:  # a HALT sentence: it touched nothing
        context.stop_timer(command)
        end(context, command, OutcomeKind.HALT_NOT_CONFIRMED, message=message, stop=StopReason.SUBSYSTEM_LOST)


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
        joints=[],
        tcp_pose=[],
        wrench=[],
        hand_width_m=0.0,
        hand_force_n=0.0,
    )


# --- closing -----------------------------------------------------------------------------------------


def close(context: DecisionContext, command: Command, report: EndReport, note: str) -> None:
    """Start the last analysis, which only updates the world facts."""
    assert command.actions is not None
    context.stop_timer(command)
    command.primitive_body = NIL
    data = {"evaluation": command.evaluation, "report": report, "closing": True}
    context.create_job(command, WorkerKind.ANALYZER, data, locations=command.actions.script.writes)
    context.start_timer(command, CLOSING_LIMIT_S)
    context.enter(command, Phase.CLOSING, note)


def stop_after_analysis(context: DecisionContext, command: Command, ending: PendingOutcome) -> None:
    """Let the running analysis update the world facts, and ignore its verdict (R138)."""
    command.pending_outcome = ending
    if command.due_s:  # a retry was scheduled, because the world database was unavailable
        retry_analysis(context, command, None)
    context.start_timer(command, CLOSING_LIMIT_S)
    context.enter(command, Phase.CLOSING, f"{ending.message}; the analysis continues, its verdict is ignored")


def finish_closing(context: DecisionContext, command: Command, product: Any) -> None:
    """End after the last analysis. `product`: its ignored verdict; None or a refusal if it failed."""
    assert command.pending_outcome is not None
    context.stop_timer(command)
    cancel(context, command)
    ending = command.pending_outcome
    end(context, command, ending.kind, message=ending.message, stop=ending.stop, refusal=ending.refusal)


def defer_closing_analysis(context: DecisionContext, command: Command, refusal: Refusal | None) -> None:
    """Defer the last analysis and end the command. `refusal`: the world database is unavailable; None: time limit."""
    assert command.pending_outcome is not None
    job = command.job
    assert job is not None
    context.stop_timer(command)
    ending = command.pending_outcome
    message = f"{ending.message}; {QUARANTINED}"
    end(context, command, ending.kind, message=message, stop=ending.stop, refusal=ending.refusal, defer_analysis=True)
    if refusal is not None:
        job.attempt += 1
        deferred_analysis.schedule_retry(context, command.id)
