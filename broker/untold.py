"""What the world has not been told yet: analyses that outlive their command, because the world database was away.

What has happened must reach the world, or the next command plans with facts that are no longer true. So what such a
command has touched stays closed, and its analysis is done again and again until the world has it. Nobody waits for
its advice. One that is refused, or kills its workers, is given up: asking again would not help.
"""

from __future__ import annotations

from broker.effects import StartTimer
from broker.events import JobDeclined, JobFinished, JobLost
from broker.resources import WORLD
from broker.state import Command, Untold
from broker.turn import Turn
from rtc.outcomes import RefusalReason

AGAIN_S = 1.0  # after one that could not be done; each waits some seconds for the world by itself
LIMIT_S = 60.0  # a command that waits for its analysis ends after so long; a restart of the world takes seconds
MAX_DEATHS = 3  # of workers with the same job in hand: it is poison


def keep(turn: Turn, command: Command) -> None:
    """The command ends, its analysis does not. Called before the resources are released."""
    assert command.job is not None
    touched = {*(command.job.locations or ()), *command.performers}
    held = turn.state.resources.held.get(command.id, {})
    names = [name for name, exclusive in held.items() if exclusive and name in touched]
    turn.state.untold[command.id] = Untold(job=command.job, names=names)
    turn.close_untold()
    turn.count("left_untold")


def later(turn: Turn, command: str) -> None:
    turn.effects.append(StartTimer(timer=turn.state.untold[command].job.id, at_s=turn.now + AGAIN_S))


def again(turn: Turn, command: str) -> None:
    job = turn.state.untold[command].job
    job.attempt += 1  # what the one before may still say is stale
    job.program = turn.state.programs.get(job.kind, job.program)
    turn.dispatch(job)


def heard(turn: Turn, event: JobFinished | JobDeclined | JobLost) -> bool:
    """An answer to such an analysis. False: it is none."""
    if not turn.state.untold:  # most of the time
        return False
    command = event.job.partition("/")[0]
    left = turn.state.untold.get(command)
    if left is None or (left.job.id, left.job.attempt) != (event.job, event.attempt):
        return False
    job = left.job
    if isinstance(event, JobDeclined) and event.refusal.reason is RefusalReason.TIMEOUT:
        job.attempt += 1
        later(turn, command)
    elif isinstance(event, JobLost) and len(job.deaths) + event.blamed < MAX_DEATHS:
        if event.blamed:
            job.deaths.append(f"{event.node}: {event.evidence}")
        again(turn, command)
    else:
        if not isinstance(event, JobFinished):
            turn.count("never_told")
        del turn.state.untold[command]
        turn.grant(turn.state.resources.confirm_rest(WORLD, moved=command, names=()))
    return True


def rang(turn: Turn, timer: str) -> bool:
    """Time to do one again. False: the timer is not one of these."""
    command = timer.partition("/")[0]
    left = turn.state.untold.get(command)
    if left is None or left.job.id != timer:
        return False
    again(turn, command)
    return True
