"""Deferred analyses: analyses that continue after their command has ended, because the world database is unavailable.

Every change must reach the world database, or the next command plans with wrong facts. The touched names therefore
stay quarantined, and the analysis is repeated until its changes are written. Its verdict is not used. An analysis that
is refused, or that kills its workers, is given up, because a retry would fail too.
"""

from __future__ import annotations

from broker.decisions.context import DecisionContext
from broker.decisions.effects import StartTimer
from broker.decisions.events import JobDeclined, JobFinished, JobLost
from broker.decisions.resources import WORLD
from broker.decisions.state import Command, DeferredAnalysis
from rtc.protocol.outcomes import RefusalReason

AGAIN_S = 1.0  # pause before a retry; the analyzer itself also waits some seconds for the world database
LIMIT_S = 60.0  # time limit for a command that waits for its analysis; a restart of the world database takes seconds
MAX_DEATHS = 3  # worker deaths per job; then the job counts as poison


def defer(context: DecisionContext, command: Command) -> None:
    """Keep the analysis of a command that ends. Call this before its resources are released."""
    assert command.job is not None
    touched = {*(command.job.locations or ()), *command.performers}
    held = context.state.resources.held.get(command.id, {})
    names = [name for name, exclusive in held.items() if exclusive and name in touched]
    context.state.deferred_analyses[command.id] = DeferredAnalysis(job=command.job, names=names)
    context.quarantine_deferred()
    context.count("analyses_deferred")


def schedule_retry(context: DecisionContext, command: str) -> None:
    context.effects.append(
        StartTimer(timer=context.state.deferred_analyses[command].job.id, at_s=context.now + AGAIN_S)
    )


def retry(context: DecisionContext, command: str) -> None:
    job = context.state.deferred_analyses[command].job
    job.attempt += 1  # a late answer to the previous attempt is stale
    context.dispatch(job)


def handle_answer(context: DecisionContext, event: JobFinished | JobDeclined | JobLost) -> bool:
    """Handle a job event of a deferred analysis. False: the event belongs to another job."""
    if not context.state.deferred_analyses:  # the usual case
        return False
    command = event.job.partition("/")[0]
    found = context.state.deferred_analyses.get(command)
    if found is None or (found.job.id, found.job.attempt) != (event.job, event.attempt):
        return False
    job = found.job
    if isinstance(event, JobDeclined) and event.refusal.reason is RefusalReason.TIMEOUT:
        job.attempt += 1
        schedule_retry(context, command)
    elif isinstance(event, JobLost) and len(job.deaths) + event.blamed < MAX_DEATHS:
        if event.blamed:
            job.deaths.append(f"{event.node}: {event.evidence}")
        retry(context, command)
    else:
        if not isinstance(event, JobFinished):
            context.count("analyses_given_up")
        del context.state.deferred_analyses[command]
        context.grant(context.state.resources.confirm_rest(WORLD, moved=command, names=()))
    return True


def handle_timer(context: DecisionContext, timer: str) -> bool:
    """Retry a deferred analysis when its timer fires. False: the timer belongs to another job."""
    command = timer.partition("/")[0]
    found = context.state.deferred_analyses.get(command)
    if found is None or found.job.id != timer:
        return False
    retry(context, command)
    return True
