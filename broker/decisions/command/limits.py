"""Time limits of a command: for rest, for an end report, and for the last analysis. Pure."""

from __future__ import annotations

from broker.decisions.state import Command, State

HALT_LIMIT_S = 2.0  # time limit for a subsystem to confirm rest, at real-time speed
REPORT_MARGIN_S = 2.0  # added where a late message, or a subsystem that must reconnect, is not yet a fault
CLOSING_LIMIT_S = 10.0  # time limit for the last analysis; then it is deferred and the command ends


def rest_limit_s(state: State, *, reconnecting: bool = False) -> float:
    """Time limit in seconds for a confirmation of rest. It is the same for every kind of halt.

    `reconnecting`: the broker has just restarted, so the subsystem must connect to it first.
    """
    return HALT_LIMIT_S * max(1.0, state.timeout_scale) + (REPORT_MARGIN_S if reconnecting else 0.0)


def report_limit_s(state: State, command: Command) -> float:
    """Time limit in seconds for the end report of the command's primitive."""
    return command.limit_s * state.timeout_scale + REPORT_MARGIN_S
