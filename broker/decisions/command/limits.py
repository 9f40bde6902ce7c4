"""Time limits of a command: for rest, for an end report, and for the last analysis. Pure.

What a subsystem is to do is limited by its own time too (`StartTimer`). So on a busy machine a simulator is not late.
"""

from __future__ import annotations

from collections.abc import Sequence

from broker.decisions.context import DecisionContext
from broker.decisions.state import Command, State

HALT_LIMIT_S = 2.0  # time limit for a subsystem to confirm rest, at real-time speed
REPORT_MARGIN_S = 2.0  # added where a late message, or a subsystem that must reconnect, is not yet a fault
CLOSING_LIMIT_S = 10.0  # time limit for the last analysis; then it is deferred and the command ends


def rest_limit_s(state: State, *, reconnecting: bool = False) -> float:
    """Time limit in seconds for a confirmation of rest. It is the same for every kind of halt.

    `reconnecting`: the broker has just restarted, so the subsystem must connect to it first.
    """
    return HALT_LIMIT_S * max(1.0, state.timeout_scale) + (REPORT_MARGIN_S if reconnecting else 0.0)


def await_rest(
    context: DecisionContext, command: Command, subsystems: Sequence[str], *, reconnecting: bool = False
) -> None:
    context.start_timer(command, rest_limit_s(context.state, reconnecting=reconnecting), subsystems)


def await_report(context: DecisionContext, command: Command) -> None:
    """Limit the time until the end report of the command's primitive."""
    limit_s = command.limit_s * context.state.timeout_scale + REPORT_MARGIN_S
    context.start_timer(command, limit_s, [command.subsystem])
