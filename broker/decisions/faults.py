"""Faults of one primitive that concern other commands too, as the table `FAULT_SCOPE` states (R47, A30). Pure.

The subsystem has stopped its arms by itself. Here the commands of these arms end, also those that do not move now.
"""

from __future__ import annotations

from broker.decisions.context import DecisionContext
from broker.decisions.events import Stimulus
from broker.decisions.state import Command, PendingOutcome
from rtc.protocol.messages import EndReport
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
