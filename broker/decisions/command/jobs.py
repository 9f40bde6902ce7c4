"""Jobs that were not done: the worker was lost, or the world database or every worker is unavailable. Pure."""

from __future__ import annotations

from typing import Any

import msgspec

from broker.decisions import deferred_analysis
from broker.decisions.command.termination import end, refuse
from broker.decisions.context import DecisionContext
from broker.decisions.events import JobLost
from broker.decisions.state import Command, PendingOutcome
from rtc.protocol import causes
from rtc.protocol.advice import by_person
from rtc.protocol.messages import NoteKind
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason

QUARANTINED = "the names it touched stay quarantined until the world database is updated"
MOST_IN_PACKAGE = 2  # deaths, if the last one has a culprit; the first one may have been by a foreign hand
EVIDENCE_CHARACTERS = 300  # of a death, in a message
SUSPECT = "the facts about what it moved become suspect"


def fail_unavailable(context: DecisionContext, command: Command, refusal: Refusal) -> None:
    """A job before a motion could not be done: refused before the first primitive, failed after it."""
    if command.primitives:
        end(context, command, PendingOutcome(OutcomeKind.FAILED, refusal.message, refusal=refusal))
    else:
        refuse(context, command, refusal)


def schedule_analysis_retry(context: DecisionContext, command: Command, refusal: Refusal) -> None:
    """Repeat an analysis while the world database is unavailable; after LIMIT_S defer it and end the command."""
    job = command.job
    assert job is not None
    if context.now - job.since_s <= deferred_analysis.LIMIT_S:
        job.attempt += 1  # a late answer to the previous attempt is stale
        context.count("analyses_again")
        context.start_timer(command, deferred_analysis.AGAIN_S)
        context.note(command, NoteKind.ANALYSIS_AGAIN, message=refusal.message)
        return
    message = (
        f"the result could not be analysed within {deferred_analysis.LIMIT_S:.0f} s: {refusal.message}; {QUARANTINED}"
    )
    refusal = Refusal(reason=refusal.reason, message=message, clears=by_person("wait until the world database is back"))
    end(context, command, PendingOutcome(OutcomeKind.FAILED, message, refusal=refusal), defer_analysis=True)
    deferred_analysis.on_unavailable(context, command.id)


def retry_analysis(context: DecisionContext, command: Command, _: Any) -> None:
    context.dispatch_again(command)


def retry_job(context: DecisionContext, command: Command, loss: JobLost) -> None:
    """Dispatch a lost job before a motion again; refuse the command if the job is poison."""
    if poison := dispatch_again(context, command, loss):
        refuse(context, command, poison)


def retry_lost_analysis(context: DecisionContext, command: Command, loss: JobLost) -> None:
    """Dispatch a lost analysis again. The motion is done, so the command fails if the job is poison."""
    if poison := dispatch_again(context, command, loss):
        give_up = has_moved(command)
        message = f"{poison.message}; {SUSPECT}" if give_up else poison.message
        end(context, command, PendingOutcome(OutcomeKind.FAILED, message, refusal=poison), defer_analysis=give_up)
        if give_up:
            deferred_analysis.on_given_up(context, command.id)


def has_moved(command: Command) -> bool:
    """True if its pending analysis is of a motion, so that facts are wrong without it. A stated fact moves nothing."""
    return command.job is not None and bool(command.primitive)


def give_up_analysis(context: DecisionContext, command: Command, refusal: Refusal) -> None:
    """End a command whose analysis is refused. If it has moved something, the facts become suspect first."""
    give_up = has_moved(command)
    if give_up:
        deferred_analysis.defer(context, command)
        refusal = msgspec.structs.replace(refusal, message=f"{refusal.message}; {SUSPECT}")
    refuse(context, command, refusal)
    if give_up:
        deferred_analysis.on_given_up(context, command.id)


def dispatch_again(context: DecisionContext, command: Command, loss: JobLost) -> Refusal | None:
    """Dispatch the job again: jobs are stateless. The refusal, if several workers died of it: such a job is poison."""
    job = command.job
    assert job is not None
    if loss.blamed:
        job.deaths += (f"{loss.node}: {loss.evidence}",)
    if len(job.deaths) < (MOST_IN_PACKAGE if loss.inside else deferred_analysis.MAX_DEATHS):
        job.attempt += 1
        context.count("jobs_again")
        context.note(command, NoteKind.WORKER_LOST, about=loss.node, message=_last_line(loss))
        context.dispatch_again(command)
        return None
    culprit, clears = f"the {job.worker.value}'s job {job.id}", "change the sentence or the program"
    if loss.inside:
        culprit, clears = (
            f"the {loss.inside} of an installed package, in {culprit},",
            "correct or uninstall its package",
        )
    return Refusal(
        reason=RefusalReason.POISON,
        message=f"{culprit} killed its worker {len(job.deaths)} times: {_last_line(loss)}",
        where=command.step_words,
        clears=by_person(f"the evidence is in the trace; {clears}"),
        cause=causes.WorkersKilled(deaths=tuple(evidence[-800:] for evidence in job.deaths)),
    )


def _last_line(loss: JobLost) -> str:
    return loss.evidence.splitlines()[-1][:EVIDENCE_CHARACTERS] if loss.evidence else "gone"
