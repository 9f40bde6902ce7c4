"""The machine of a command: for each phase and stimulus the action and the phases that may follow. Pure.

The actions are functions of the modules beside this one. `docs/decision_unit.md` is drawn from this table.
"""

from __future__ import annotations

from typing import Any

from broker.decisions.command import (
    claims,
    closing,
    control,
    dependencies,
    intake,
    jobs,
    nominal,
    pacing,
    rehearsal,
    space,
    stopping,
    termination,
)
from broker.decisions.context import DecisionContext
from broker.decisions.events import Stimulus
from broker.decisions.machine import Ignored, InvalidTransition, Machine, TableCell, cell
from broker.decisions.state import Command, State
from rtc.protocol.messages import Phase

S, P = Stimulus, Phase
PARSING = P.PARSING  # a constant, as in `broker.decisions.decide`
STEP = (P.BINDING, P.PAUSED, P.ENDED)  # the next step is bound, or the command pauses, or no step is left
FROM_ELABORATION = (P.ELABORATING, P.HELD, P.ENDED)  # the resources are granted, or the command waits, or it is refused

_ROWS: dict[Phase, dict[Stimulus, TableCell[Phase]]] = {
    P.PARSING: {
        S.PRODUCT: cell(intake.on_parsed, P.PARSING, P.REHEARSING, *FROM_ELABORATION, P.HALTING),
        S.RELEASE: cell(intake.take_up, *FROM_ELABORATION),
        S.REFUSAL: cell(termination.refuse, P.ENDED),
        S.UNAVAILABLE: cell(jobs.fail_unavailable, P.ENDED),
        S.WORKER_LOST: cell(jobs.retry_job, P.PARSING, P.ENDED),
        S.STOP: cell(termination.stop, P.ENDED),
        S.PAUSE: cell(control.request_pause, P.PARSING),
        S.RESUME: cell(control.withdraw_pause, P.PARSING),
    },
    P.REHEARSING: {
        S.PRODUCT: cell(rehearsal.on_rehearsed, P.ENDED),
        S.REFUSAL: cell(termination.refuse, P.ENDED),
        S.UNAVAILABLE: cell(jobs.fail_unavailable, P.ENDED),
        S.WORKER_LOST: cell(jobs.retry_job, P.REHEARSING, P.ENDED),
        S.STOP: cell(termination.stop, P.ENDED),
    },
    P.ELABORATING: {
        S.PRODUCT: cell(nominal.on_elaborated, P.HELD, *STEP),
        S.REFUSAL: cell(space.on_refused, P.WAITING, P.ELABORATING, P.ENDED),
        S.UNAVAILABLE: cell(jobs.fail_unavailable, P.ENDED),
        S.WORKER_LOST: cell(jobs.retry_job, P.ELABORATING, P.ENDED),
        S.STOP: cell(termination.stop, P.ENDED),
        S.PAUSE: cell(control.request_pause, P.ELABORATING),
        S.RESUME: cell(control.withdraw_pause, P.ELABORATING),
    },
    P.HELD: {
        S.GRANT: cell(claims.on_granted, P.ELABORATING, P.HELD, P.ENDED),
        S.RELEASE: cell(dependencies.on_released, *FROM_ELABORATION),
        S.STOP: cell(termination.stop, P.ENDED),
        S.PAUSE: cell(control.request_pause, P.HELD),
        S.RESUME: cell(dependencies.on_resumed, *FROM_ELABORATION),
    },
    P.WAITING: {
        S.SPACE: cell(space.plan_again, P.ELABORATING, P.BINDING, P.PAUSED),
        S.STOP: cell(termination.stop, P.ENDED),
        S.PAUSE: cell(space.pause, P.WAITING, P.PAUSED),
        S.RESUME: cell(control.withdraw_pause, P.WAITING),
        S.SUBSYSTEM_LOST: cell(stopping.stop_lost, P.ENDED),
    },
    P.BINDING: {
        S.PRODUCT: cell(nominal.on_bound, P.EXECUTING, P.ANALYZING, *STEP),
        S.REFUSAL: cell(space.on_refused, P.WAITING, P.BINDING, P.PAUSED, P.ENDED),
        S.UNAVAILABLE: cell(jobs.fail_unavailable, P.ENDED),
        S.WORKER_LOST: cell(jobs.retry_job, P.BINDING, P.ENDED),
        S.STOP: cell(termination.stop, P.ENDED),
        S.PAUSE: cell(control.request_pause, P.BINDING),
        S.RESUME: cell(control.withdraw_pause, P.BINDING),
        S.SUBSYSTEM_LOST: cell(stopping.stop_lost, P.ENDED),
    },
    P.EXECUTING: {
        S.REPORT: cell(space.on_reported, P.ANALYZING, P.CLOSING, P.WAITING, P.BINDING, P.PAUSED, P.ENDED),
        S.STOP: cell(stopping.stop_primitive, P.HALTING),
        S.PAUSE: cell(pacing.pause_motion, P.EXECUTING),
        S.RESUME: cell(pacing.resume_motion, P.EXECUTING),
        S.TIMEOUT: cell(pacing.on_overdue, P.HALTING, P.EXECUTING),
        S.SUBSYSTEM_LOST: cell(stopping.on_subsystem_lost, P.CLOSING),
    },
    P.ANALYZING: {
        S.PRODUCT: cell(space.on_assessed, P.WAITING, *STEP),
        S.REFUSAL: cell(jobs.give_up_analysis, P.ENDED),
        S.UNAVAILABLE: cell(jobs.schedule_analysis_retry, P.ANALYZING, P.ENDED),
        S.WORKER_LOST: cell(jobs.retry_lost_analysis, P.ANALYZING, P.ENDED),
        S.STOP: cell(closing.stop_after_analysis, P.CLOSING),
        S.PAUSE: cell(control.request_pause, P.ANALYZING),
        S.RESUME: cell(control.withdraw_pause, P.ANALYZING),
        S.TIMEOUT: cell(jobs.retry_analysis, P.ANALYZING),
        S.SUBSYSTEM_LOST: cell(stopping.stop_lost_after_analysis, P.CLOSING),
    },
    P.PAUSED: {
        S.STOP: cell(termination.stop, P.ENDED),
        S.RESUME: cell(control.resume, P.BINDING),
        S.STEP: cell(control.step, P.BINDING),
        S.SUBSYSTEM_LOST: cell(stopping.stop_lost, P.ENDED),
    },
    P.HALTING: {
        S.REPORT: cell(stopping.on_rested, P.CLOSING),
        S.REST: cell(stopping.on_rest_confirmed, P.CLOSING),
        S.HALT_SETTLED: cell(control.end_halt, P.ENDED),
        S.TIMEOUT: cell(stopping.fail_unconfirmed, P.CLOSING),
        S.SUBSYSTEM_LOST: cell(stopping.on_lost_while_halting, P.CLOSING),
    },
    P.CLOSING: {
        S.PRODUCT: cell(closing.finish_closing, P.ENDED),
        S.REFUSAL: cell(closing.give_up_closing_analysis, P.ENDED),
        S.UNAVAILABLE: cell(closing.defer_closing_analysis, P.ENDED),
        S.WORKER_LOST: cell(closing.retry_last_analysis, P.CLOSING, P.ENDED),
        S.TIMEOUT: cell(closing.defer_closing_analysis, P.ENDED),
    },
    P.ENDED: {},
}

_ANSWERS = (S.PRODUCT, S.REFUSAL, S.UNAVAILABLE, S.WORKER_LOST)  # of the worker that has the command's job
_IGNORED: list[Ignored[Phase, Stimulus]] = [
    Ignored((P.HELD, P.WAITING, P.EXECUTING, P.PAUSED, P.HALTING), _ANSWERS, "no job is pending; the answer is late"),
    Ignored([p for p in P if p not in (P.HELD, P.ENDED)], [S.GRANT], "it waits for no resource"),
    Ignored([p for p in P if p not in (P.WAITING, P.ENDED)], [S.SPACE], "it waits for no arm"),
    Ignored([p for p in P if p not in (P.PAUSED, P.ENDED)], [S.STEP], "it is not paused between two steps"),
    Ignored([p for p in P if p not in (P.PARSING, P.HELD, P.ENDED)], [S.RELEASE], "it waits for no other command"),
    Ignored([p for p in P if p not in (P.EXECUTING, P.HALTING, P.ENDED)], [S.REPORT], "no primitive is executing"),
    Ignored([p for p in P if p not in (P.HALTING, P.ENDED)], [S.REST], "no halt of it is open"),
    Ignored([p for p in P if p not in (P.HALTING, P.ENDED)], [S.HALT_SETTLED], "it is not a HALT sentence"),
    Ignored(
        [P.PARSING, P.REHEARSING, P.ELABORATING, P.HELD, P.WAITING, P.BINDING, P.PAUSED],
        [S.TIMEOUT],
        "no timer runs: it was stopped as it fired",
    ),
    Ignored([P.PARSING, P.ELABORATING, P.HELD], [S.SUBSYSTEM_LOST], "it has not used a subsystem yet"),
    Ignored([P.REHEARSING], [S.SUBSYSTEM_LOST, S.PAUSE, S.RESUME], "it moves nothing"),
    Ignored([P.HALTING, P.CLOSING], [S.STOP, S.PAUSE, S.RESUME], "it is ending already"),
    Ignored([P.CLOSING], [S.SUBSYSTEM_LOST], "it is ending already"),
    Ignored([P.PAUSED], [S.PAUSE], "it is paused already"),
    Ignored([P.ENDED], S, "it is no longer in the state"),
]


def phase_of(state: State, name: str) -> Phase:
    command = state.commands.get(name)
    return Phase.ENDED if command is None else command.phase


COMMAND = Machine(Phase, Stimulus, _ROWS, _IGNORED, first=P.PARSING, state_of=phase_of)


_cells = COMMAND.cells


def stimulate(context: DecisionContext, command: Command, stimulus: Stimulus, payload: Any = None) -> None:
    """Run the action of the table for this stimulus, and check the phase it leads to."""
    before = command.phase
    found = _cells.get((before, stimulus))
    if found is None:
        context.count("stale")
        return
    found.action(context, command, payload)
    if command.phase not in found.following:
        raise InvalidTransition(_with_trace(command, before, stimulus))
    if before is PARSING and command.phase is not PARSING:
        context.leave_intake(command)


def _with_trace(command: Command, before: Phase, stimulus: Stimulus) -> str:
    trace = "\n".join(f"  {n.at_s:.3f} {n.phase.value} {n.step} {n.kind} {n.message}" for n in command.notes[-20:])
    return (
        f"{command.id}: {stimulus.value} in {before.value} led to {command.phase.value}, "
        f"which the table does not allow\n{trace}"
    )
