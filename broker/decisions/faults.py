"""Faults that concern other commands too: those of the table `FAULT_SCOPE` (R47, A30), and motions of an arm at rest.
Pure.

The subsystem has stopped its arms by itself. Here the commands of these arms end, also those that do not move now.
"""

from __future__ import annotations

from broker.decisions.command.termination import end
from broker.decisions.context import DecisionContext
from broker.decisions.events import ArmStrayed, Stimulus
from broker.decisions.state import Command, JobKind, PendingJob, PendingOutcome, request_key
from rtc.protocol import wire
from rtc.protocol.messages import EndReport, Phase, WorkerKind
from rtc.protocol.outcomes import FAULT_SCOPE, FaultScope, OutcomeKind


def stop_others(context: DecisionContext, command: Command, report: EndReport) -> None:
    """Stop the other commands that this report concerns: every task that has been taken up."""
    if FAULT_SCOPE[report.reason] is not FaultScope.SUBSYSTEM:
        return
    message = f"stopped with {command.id}: {report.message or report.reason.value}"
    over = PendingOutcome(kind=OutcomeKind.FAILED, message=message, stop=report.reason)
    for other in context.state.commands.values():
        if other is not command and other.head is not None and other.head.kind == "task":
            context.enqueue_stimulus(other.id, Stimulus.STOP, over)


def on_strayed(context: DecisionContext, event: ArmStrayed) -> None:
    """End the commands that use the arm, and make the facts about it suspect.

    An entry of its own among the commands, without a client, shows it to the operator; its deferred analysis makes the
    facts suspect, and the arm stays closed until that is done.
    """
    state = context.state
    words = f"{event.arm} {event.how}"
    over = PendingOutcome(kind=OutcomeKind.FAILED, message=f"stopped: {words}")
    for other in state.commands.values():
        if event.arm in state.resources.held.get(other.id, {}):
            context.enqueue_stimulus(other.id, Stimulus.STOP, over)
    state.accepted += 1
    command = Command(
        id=f"C-{state.accepted}",
        client=event.subsystem,
        request=f"{event.arm} at {event.at_s:.6f}",
        text=f"{event.arm} moved without a command",
        source=event.subsystem,
        progress=False,
        halt_if_lost=False,
        accepted_at_s=event.at_s,
        phase=Phase.HELD,
    )
    state.commands[command.id] = command
    state.live[command.client] = state.live.get(command.client, 0) + 1
    state.requests[request_key(command.client, command.request)] = command.id
    command.job = PendingJob(
        id=f"{command.id}/1",
        attempt=1,
        worker=WorkerKind.ANALYZER,
        kind=JobKind.SUSPECT,
        about=words,
        program=state.programs.get(WorkerKind.ANALYZER, ""),
        input=wire.raw(None),
        locations=(event.arm,),
        since_s=context.now,
    )
    context.dispatch(command.job)
    state.resources.take(command.id, {event.arm: True})
    message = f"{words}; its facts are suspect until they are read again: the next command of the arm reads them"
    end(context, command, PendingOutcome(OutcomeKind.FAILED, message), defer_analysis=True)
