"""What the world has not been told yet: analyses that outlive their command, because the world database was away.

What has happened must reach the world, or the next command plans with facts that are no longer true. So what such a
command has touched stays closed, and its analysis is done again and again until the world has it. Nobody waits for
its advice. One that is refused, or kills its workers, is given up: asking again would not help.
"""

from __future__ import annotations

from broker.effects import StartTimer
from broker.events import JobDeclined, JobFinished, JobLost
from broker.resources import WORLD
from broker.state import Command, DeferredAnalysis
from broker.turn import DecisionContext
from rtc.outcomes import RefusalReason

AGAIN_S = 1.0  # after one that could not be done; each waits some seconds for the world by itself
LIMIT_S = 60.0  # a command that waits for its analysis ends after so long; a restart of the world takes seconds
MAX_DEATHS = 3  # of workers with the same job in hand: it is poison


def defer(context: DecisionContext, command: Command) -> None:
    """The command ends, its analysis does not. Called before the resources are released."""
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
    job.attempt += 1  # what the one before may still say is stale
    job.program = context.state.programs.get(job.kind, job.program)
    context.dispatch(job)


def handle_answer(context: DecisionContext, event: JobFinished | JobDeclined | JobLost) -> bool:
    """An answer to such an analysis. False: it is none."""
    if not context.state.deferred_analyses:  # most of the time
        return False
    command = event.job.partition("/")[0]
    left = context.state.deferred_analyses.get(command)
    if left is None or (left.job.id, left.job.attempt) != (event.job, event.attempt):
        return False
    job = left.job
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
    """Time to do one again. False: the timer is not one of these."""
    command = timer.partition("/")[0]
    left = context.state.deferred_analyses.get(command)
    if left is None or left.job.id != timer:
        return False
    retry(context, command)
    return True
