"""The deferred analysis of a command that has ended, because the world database was unavailable. Pure.

Every change must reach the world database, or the next command plans with wrong facts. The touched names therefore
stay quarantined, and the analysis is repeated until its changes are written. Its verdict is not used. An analysis that
is refused, or that kills its workers, is given up, because a retry would fail too. Its job then makes the facts about
these names suspect, and is repeated until the world database has done that.
"""

from __future__ import annotations

from enum import StrEnum

from broker.decisions.context import DecisionContext
from broker.decisions.effects import StartTimer
from broker.decisions.events import BrokerRestarted, JobDeclined, JobFinished, JobLost
from broker.decisions.machine import Ignored, Machine, TableCell, cell
from broker.decisions.resources import WORLD
from broker.decisions.state import Command, Deferral, DeferredAnalysis, JobKind, State
from rtc.protocol.outcomes import RefusalReason

AGAIN_S = 1.0  # pause before a retry; the analyzer itself also waits some seconds for the world database
LIMIT_S = 60.0  # time limit for a command that waits for its analysis; a restart of the world database takes seconds
MAX_DEATHS = 3  # worker deaths per job; then the job counts as poison


class DeferralStimulus(StrEnum):
    """What an event means to a deferred analysis."""

    DEFER = "defer"  # its command ends before the analysis is done; payload: the command
    DONE = "done"  # its changes are written
    REFUSAL = "refusal"  # or the analysis was refused, or poison, before its command ended
    UNAVAILABLE = "unavailable"  # the world database, or every analyzer, is unavailable
    WORKER_LOST = "worker_lost"  # payload: the event
    TIMEOUT = "timeout"  # time for a retry
    BROKER_RESTARTED = "broker_restarted"


def defer(context: DecisionContext, command: Command) -> None:
    """Keep the analysis of a command that ends. Call this before its resources are released."""
    DEFERRED.run(context, command.id, DeferralStimulus.DEFER, command)


def on_unavailable(context: DecisionContext, command: str) -> None:
    DEFERRED.run(context, command, DeferralStimulus.UNAVAILABLE)


def on_given_up(context: DecisionContext, command: str) -> None:
    DEFERRED.run(context, command, DeferralStimulus.REFUSAL)


def on_broker_restarted(context: DecisionContext, event: BrokerRestarted) -> None:
    for name in context.state.deferred_analyses:
        DEFERRED.run(context, name, DeferralStimulus.BROKER_RESTARTED)


def handle_answer(context: DecisionContext, event: JobFinished | JobDeclined | JobLost) -> bool:
    """Handle a job event of a deferred analysis. False: the event belongs to another job."""
    command = event.job.partition("/")[0]
    found = context.state.deferred_analyses.get(command)
    if found is None or (found.job.id, found.job.attempt) != (event.job, event.attempt):
        return False
    DEFERRED.run(context, command, _stimulus(event), event)
    return True


def _stimulus(event: JobFinished | JobDeclined | JobLost) -> DeferralStimulus:
    if isinstance(event, JobFinished):
        return DeferralStimulus.DONE
    if isinstance(event, JobLost):
        return DeferralStimulus.WORKER_LOST
    away = event.refusal.reason is RefusalReason.TIMEOUT
    return DeferralStimulus.UNAVAILABLE if away else DeferralStimulus.REFUSAL


def handle_timer(context: DecisionContext, timer: str) -> bool:
    """Retry a deferred analysis when its timer fires. False: the timer belongs to another job."""
    command = timer.partition("/")[0]
    found = context.state.deferred_analyses.get(command)
    if found is None or found.job.id != timer:
        return False
    DEFERRED.run(context, command, DeferralStimulus.TIMEOUT)
    return True


# --- actions -----------------------------------------------------------------------------------------


def keep(context: DecisionContext, name: str, command: Command) -> None:
    """Take over the job of the command, and close the names that it may still change."""
    assert command.job is not None
    touched = {*(command.job.locations or ()), *command.performers}
    held = context.state.resources.held.get(name, {})
    names = [held_name for held_name, exclusive in held.items() if exclusive and held_name in touched]
    context.state.deferred_analyses[name] = DeferredAnalysis(job=command.job, names=names)
    context.quarantine_deferred()
    context.count("analyses_deferred")


def schedule_retry(context: DecisionContext, name: str, _: object) -> None:
    analysis = context.state.deferred_analyses[name]
    analysis.phase = Deferral.WAITING
    analysis.job.attempt += 1  # a late answer to the previous attempt is stale
    context.effects.append(StartTimer(timer=analysis.job.id, at_s=context.now + AGAIN_S))


def retry(context: DecisionContext, name: str, _: object) -> None:
    analysis = context.state.deferred_analyses[name]
    analysis.phase = Deferral.RUNNING
    analysis.job.attempt += 1  # a late answer to the previous attempt is stale
    context.dispatch(analysis.job)


def retry_or_give_up(context: DecisionContext, name: str, loss: JobLost) -> None:
    """Retry, unless MAX_DEATHS workers have died of this job."""
    job = context.state.deferred_analyses[name].job
    if job.kind is JobKind.SUSPECT or len(job.deaths) + loss.blamed >= MAX_DEATHS:
        give_up(context, name, loss)
        return
    if loss.blamed:
        job.deaths += (f"{loss.node}: {loss.evidence}",)
    retry(context, name, loss)


def give_up(context: DecisionContext, name: str, event: object) -> None:
    """Make the facts suspect instead: the changes are unknown. This is retried without a maximum count."""
    analysis = context.state.deferred_analyses[name]
    if analysis.job.kind is not JobKind.SUSPECT:
        context.count("analyses_given_up")
        analysis.job.kind, analysis.job.about = JobKind.SUSPECT, f"the analysis of {name} was given up"
        analysis.job.locations = (*sorted({*(analysis.job.locations or ()), *analysis.names}),)
    schedule_retry(context, name, event)


def finish(context: DecisionContext, name: str, _: object) -> None:
    """Open the names again."""
    del context.state.deferred_analyses[name]
    opened = context.state.resources.confirm_rest(WORLD, moved=name, names=())
    context.forget_motions()
    context.grant(opened)


# --- table -------------------------------------------------------------------------------------------

S, D = DeferralStimulus, Deferral

_ROWS: dict[Deferral, dict[DeferralStimulus, TableCell[Deferral]]] = {
    D.NONE: {
        S.DEFER: cell(keep, D.RUNNING),
    },
    D.RUNNING: {
        S.DONE: cell(finish, D.NONE),
        S.REFUSAL: cell(give_up, D.WAITING),
        S.UNAVAILABLE: cell(schedule_retry, D.WAITING),
        S.WORKER_LOST: cell(retry_or_give_up, D.RUNNING, D.WAITING),
        S.BROKER_RESTARTED: cell(retry, D.RUNNING),
    },
    D.WAITING: {
        S.TIMEOUT: cell(retry, D.RUNNING),
        S.BROKER_RESTARTED: cell(retry, D.RUNNING),
    },
}
_IGNORED: list[Ignored[Deferral, DeferralStimulus]] = [
    Ignored([D.NONE], [s for s in S if s is not S.DEFER], "no analysis is deferred, or it is over"),
    Ignored([D.RUNNING, D.WAITING], [S.DEFER], "a command ends once"),
    Ignored([D.RUNNING], [S.TIMEOUT], "a restart of the broker has retried it already"),
    Ignored([D.WAITING], [S.DONE, S.REFUSAL, S.UNAVAILABLE, S.WORKER_LOST], "no worker has this attempt"),
]


def phase_of(state: State, name: str) -> Deferral:
    found = state.deferred_analyses.get(name)
    return D.NONE if found is None else found.phase


DEFERRED = Machine(Deferral, DeferralStimulus, _ROWS, _IGNORED, first=D.NONE, state_of=phase_of)
