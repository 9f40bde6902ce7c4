"""Access rights over tcp: one table, endpoint x role -> messages that may be sent. Pure.

The gateway checks every message against it. The role is that of the key of the connection; a message cannot choose it.
A role without a row for an endpoint does not pass the handshake there. Processes on the cluster's own machine have no
role: access to the run directory proves that they belong to its owner.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

from rtc.protocol import messages as m
from rtc.protocol.sentence import ParsedCommand


class Role(StrEnum):
    """What the holder of a key may do."""

    OBSERVER = "observer"  # reads only: status, traces, events, telemetry, the world
    PLANNER = "planner"  # a planning program: sentences, halts, control of its own commands; may not load programs
    OPERATOR = "operator"  # everything, except what the supervisor and the simulator's test bench do
    WORKER = "worker"  # a worker on another host: takes jobs, reads the world, writes under a lease
    SUBSYSTEM = "subsystem"  # performs primitives; its name is the name of its key


Kinds = tuple[type[m.Message], ...]
OBSERVER_MAY: Kinds = (m.ClientHello, m.StatusQuery, m.TraceQuery, m.ProgramQuery)
PLANNER_MAY: Kinds = (*OBSERVER_MAY, m.CommandText, m.Heartbeat)
OPERATOR_MAY: Kinds = (*PLANNER_MAY, m.ProgramText, m.SetBreakpoints, m.StepCommand, m.Shutdown)
READ: Kinds = (m.ReadView, m.WorldHistory)
JOIN: Kinds = (m.WorkerHello, m.Heartbeat, m.ResultBatch, m.ProgramWanted, m.WorkerGone)
PERFORM: Kinds = (
    *(m.SubsystemHello, m.Heartbeat, m.Started, m.PauseChanged, m.ProgressReport, m.EndReport),
    *(m.HaltStarted, m.HaltAtRest, m.HaltOrder, m.Injected, m.Strayed, m.AnswerRefused),
)
HALT: Kinds = (m.HaltOrder,)
LISTEN: Kinds = ()  # subscribers send nothing
NOTHING: Kinds = ()  # may connect, but every message is declined

#: endpoint -> role -> messages it may send. The port of the n-th endpoint is n above the first.
MAY: dict[str, dict[Role, Kinds]] = {
    "front": {Role.OBSERVER: OBSERVER_MAY, Role.PLANNER: PLANNER_MAY, Role.OPERATOR: OPERATOR_MAY},
    "halt": {Role.OBSERVER: NOTHING, Role.PLANNER: HALT, Role.OPERATOR: HALT},
    "estop": {Role.OBSERVER: NOTHING, Role.PLANNER: HALT, Role.OPERATOR: HALT},
    "events": {Role.OBSERVER: LISTEN, Role.PLANNER: LISTEN, Role.OPERATOR: LISTEN},
    "telemetry": {Role.OBSERVER: LISTEN, Role.PLANNER: LISTEN, Role.OPERATOR: LISTEN},
    "world": {Role.OBSERVER: READ, Role.PLANNER: READ, Role.OPERATOR: READ, Role.WORKER: (*READ, m.Commit)},
    "workers": {Role.WORKER: JOIN},
    "subsystems": {Role.SUBSYSTEM: PERFORM},
    "operate": {Role.OPERATOR: (m.Operate,)},
}
TCP_ENDPOINTS = tuple(MAY)


def a_role(role: Role) -> str:
    """The role with its article: an operator, a worker."""
    return f"an {role}" if role[0] in "aeiou" else f"a {role}"


def admits(endpoint: str, role: Role) -> bool:
    """Whether a role may connect to an endpoint."""
    return role in MAY.get(endpoint, {})


def may_send(endpoint: str, role: Role, message: object) -> bool:
    """Whether a role may send this message to an endpoint."""
    return isinstance(message, MAY.get(endpoint, {}).get(role, NOTHING))


def refuse_planner(parsed: ParsedCommand, is_its_own: Callable[[str], bool]) -> str:
    """Why a planner may not submit this sentence; empty if it may.

    A role that can move an arm may halt everything. But only its owner or the operator resumes a paused command, and
    only the operator answers a question to the operator. `is_its_own`: whether the planner submitted that command.
    """
    if parsed.kind == "operator":
        return f"{parsed.verb} is reserved for the operator"
    if parsed.verb == "LOAD":
        return "a planner may not load programs"
    if parsed.kind == "control" and parsed.verb != "HALT" and not is_its_own(parsed.object or ""):
        return f"a planner may send {parsed.verb} only for its own commands, by their number (HALT is allowed for all)"
    return ""
