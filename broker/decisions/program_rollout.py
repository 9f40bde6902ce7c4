"""The roll-out of programs, one machine per kind of worker: a new program is on trial until it has done a job. Pure.

If its first job fails, the program before it is used again. A program that is proven needs no trial. A command keeps
the programs it began with, so a job may also use a program that is no longer in use.
"""

from __future__ import annotations

from enum import StrEnum

from broker.decisions.context import DecisionContext
from broker.decisions.events import ProgramInstalled
from broker.decisions.machine import Ignored, Machine, TableCell, cell
from broker.decisions.state import Command, JobKind, PendingJob, Rollout, RolloutPhase, State, TakenProgram
from rtc.protocol.messages import NoteKind

PROVEN_KEPT = 16  # proven programs stored per worker kind
HISTORY_KEPT = 32  # programs per worker kind in `rtc programs`, with at most
CHANGES_KEPT = 20  # changes of each


class RolloutStimulus(StrEnum):
    """What an event means to the roll-out for one kind of worker."""

    INSTALL = "install"  # a program is loaded; payload: its digest
    JOB_DONE = "job_done"  # a job that used the newest program was done
    JOB_FAILED = "job_failed"  # a job that used the newest program failed; payload: why, in words


def on_installed(context: DecisionContext, event: ProgramInstalled) -> None:
    state = context.state
    state.began_at_s = state.began_at_s or event.at_s  # a cluster starts with the installation of its programs
    if event.kind is None:
        state.programs["cell"] = event.digest
    else:
        ROLLOUT.run(context, event.kind, RolloutStimulus.INSTALL, event.digest)
        taken = TakenProgram(
            digest=event.digest, file=event.file, at_s=event.at_s, changes=event.changes[:CHANGES_KEPT]
        )
        history = state.program_history.setdefault(event.kind, [])
        history.append(taken)
        del history[:-HISTORY_KEPT]


def taken(state: State, kind: str, digest: str) -> TakenProgram | None:
    """When and from which file a program was last taken into use; None if that is forgotten."""
    return next((one for one in reversed(state.program_history.get(kind, ())) if one.digest == digest), None)


def is_on_trial(state: State, job: PendingJob) -> bool:
    """Whether the job uses a program that has not done a job yet."""
    rollout = state.rollouts.get(job.worker)
    return rollout is not None and rollout.phase is RolloutPhase.TRIAL and state.programs[job.worker] == job.program


def on_job_done(context: DecisionContext, job: PendingJob) -> None:
    rollout = context.state.rollouts.get(job.worker) if job.kind is not JobKind.REHEARSAL else None
    if rollout is not None and rollout.fallback and is_on_trial(context.state, job):
        ROLLOUT.run(context, job.worker, RolloutStimulus.JOB_DONE)


def repeat_with_another(context: DecisionContext, command: Command, job: PendingJob, why: str) -> bool:
    """Repeat a failed job with the program in use, if its own program has never done a job. `why`: text of the failure.

    If this was the first job of the newest program, that program is rolled back. Returns False if the job's program is
    in use or has worked: then the failure is of the job."""
    if job.kind is JobKind.REHEARSAL:
        return False  # it uses several programs, and says nothing about one of them
    state, kind, failed = context.state, job.worker.value, job.program
    last_words = (why.strip().splitlines() or ["without an error message"])[-1]
    if is_on_trial(state, job):
        back_to = state.rollouts[kind].fallback
        words = f"the new {kind} program {failed} failed in {command.id} ({last_words}); back to {back_to}"
        ROLLOUT.run(context, kind, RolloutStimulus.JOB_FAILED, words)
    following = command.programs.get(kind, job.program)  # it differs if the job's program was rolled back
    if following == job.program and not _is_proven(state, job):
        following = state.programs.get(kind, job.program)
    if following == job.program:
        return False
    command.programs[kind] = job.program = following
    job.attempt += 1
    context.note(command, NoteKind.PROGRAM_FAILED, about=kind, program=failed, message=last_words, warning=True)
    context.dispatch(job, command.client)
    return True


def _is_proven(state: State, job: PendingJob) -> bool:
    rollout = state.rollouts.get(job.worker)
    return rollout is not None and job.program in rollout.proven


# --- actions -----------------------------------------------------------------------------------------


def replace(context: DecisionContext, kind: str, digest: str) -> None:
    """Use another program. The first one of a kind has no alternative, so it needs no trial."""
    _use(context, kind, digest, context.state.programs.get(kind, digest))


def replace_trial(context: DecisionContext, kind: str, digest: str) -> None:
    """Use another program than the one on trial, which is not one to return to."""
    if digest != context.state.programs[kind]:
        _use(context, kind, digest, context.state.rollouts[kind].fallback)


def _use(context: DecisionContext, kind: str, digest: str, before: str) -> None:
    """Use a program. `before`: a proven program, to return to if the new one fails."""
    rollout = context.state.rollouts.setdefault(kind, Rollout())
    context.state.programs[kind] = digest
    _prove(rollout, before)
    rollout.why = ""
    if digest in rollout.proven:
        rollout.phase, rollout.fallback = RolloutPhase.PROVEN, ""
    else:
        rollout.phase, rollout.fallback = RolloutPhase.TRIAL, before


def prove(context: DecisionContext, kind: str, _: object) -> None:
    rollout = context.state.rollouts[kind]
    rollout.phase, rollout.fallback = RolloutPhase.PROVEN, ""
    _prove(rollout, context.state.programs[kind])


def roll_back(context: DecisionContext, kind: str, why: str) -> None:
    """Return to the last program that worked, also for the live commands that began with the failed one."""
    state, rollout = context.state, context.state.rollouts[kind]
    failed, state.programs[kind] = state.programs[kind], rollout.fallback
    rollout.phase, rollout.why = RolloutPhase.ROLLED_BACK, why
    context.count("programs_rolled_back")
    for command in state.commands.values():
        if command.programs.get(kind) == failed:
            command.programs[kind] = rollout.fallback
    for deferred in state.deferred_analyses.values():
        if deferred.job.program == failed:
            deferred.job.program = rollout.fallback
    rollout.fallback = ""


def _prove(rollout: Rollout, digest: str) -> None:
    """Record that a program works: it needs no further trial, and one may return to it."""
    if digest in rollout.proven:
        rollout.proven.remove(digest)
    rollout.proven.append(digest)
    del rollout.proven[:-PROVEN_KEPT]


# --- table -------------------------------------------------------------------------------------------

S, R = RolloutStimulus, RolloutPhase

_ROWS: dict[RolloutPhase, dict[RolloutStimulus, TableCell[RolloutPhase]]] = {
    R.NONE: {
        S.INSTALL: cell(replace, R.PROVEN),
    },
    R.PROVEN: {
        S.INSTALL: cell(replace, R.TRIAL, R.PROVEN),
    },
    R.TRIAL: {
        S.INSTALL: cell(replace_trial, R.TRIAL, R.PROVEN),
        S.JOB_DONE: cell(prove, R.PROVEN),
        S.JOB_FAILED: cell(roll_back, R.ROLLED_BACK),
    },
    R.ROLLED_BACK: {
        S.INSTALL: cell(replace, R.TRIAL, R.PROVEN),
    },
}
_IGNORED: list[Ignored[RolloutPhase, RolloutStimulus]] = [
    Ignored([R.NONE], [S.JOB_DONE, S.JOB_FAILED], "a job needs a program"),
    Ignored([R.PROVEN, R.ROLLED_BACK], [S.JOB_DONE], "the program in use is proven already"),
    Ignored([R.PROVEN, R.ROLLED_BACK], [S.JOB_FAILED], "the program in use has worked, so the failure is of the job"),
]


def phase_of(state: State, kind: str) -> RolloutPhase:
    rollout = state.rollouts.get(kind)
    return R.NONE if rollout is None else rollout.phase


ROLLOUT = Machine(RolloutPhase, RolloutStimulus, _ROWS, _IGNORED, first=R.NONE, state_of=phase_of)
