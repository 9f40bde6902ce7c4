"""Who may say what from another machine: one table, door x role -> messages. Pure.

The gate (`broker/gate.py`) asks it for every message; the role is that of the key with which the connection was made,
never something a message says. A role that has no row at a door does not even get through the handshake there. On the
cluster's own machine there are no roles: whoever can open the run directory is its owner.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

from rtc import messages as m
from rtc.language.record import ParsedCommand


class Role(StrEnum):
    """What the holder of a key is for; one line of meaning each."""

    OBSERVER = "observer"  # looks on: status, traces, events, telemetry, the world
    PLANNER = "planner"  # a program: sentences, halts, control of its own commands; changes no program
    OPERATOR = "operator"  # whatever can be done on the cluster's own machine, but the supervisor's and the simulator's
    WORKER = "worker"  # one of the cube's nodes on another host: takes jobs, reads the world, writes under a lease
    SUBSYSTEM = "subsystem"  # performs primitives; its name is the name of its key


Kinds = tuple[type[m.Message], ...]
LOOK: Kinds = (m.ClientHello, m.StatusQuery, m.TraceQuery, m.ProgramQuery)
PLAN: Kinds = (*LOOK, m.CommandText, m.Heartbeat)
OPERATE: Kinds = (*PLAN, m.ProgramText, m.Shutdown)
READ: Kinds = (m.ReadView, m.WorldHistory)
JOIN: Kinds = (m.WorkerHello, m.Heartbeat, m.ResultBatch, m.ProgramWanted)
PERFORM: Kinds = (
    *(m.SubsystemHello, m.Heartbeat, m.Started, m.ProgressReport, m.EndReport),
    *(m.HaltStarted, m.HaltAtRest, m.HaltOrder),
)
HALT: Kinds = (m.HaltOrder,)
LISTEN: Kinds = ()  # what is published is there for who has come in
NOTHING: Kinds = ()  # comes in only to be told that it may not

#: door -> role -> what it may say. The n-th door is n ports above the first.
MAY: dict[str, dict[Role, Kinds]] = {
    "front": {Role.OBSERVER: LOOK, Role.PLANNER: PLAN, Role.OPERATOR: OPERATE},
    "halt": {Role.OBSERVER: NOTHING, Role.PLANNER: HALT, Role.OPERATOR: HALT},
    "estop": {Role.OBSERVER: NOTHING, Role.PLANNER: HALT, Role.OPERATOR: HALT},
    "events": {Role.OBSERVER: LISTEN, Role.PLANNER: LISTEN, Role.OPERATOR: LISTEN},
    "telemetry": {Role.OBSERVER: LISTEN, Role.PLANNER: LISTEN, Role.OPERATOR: LISTEN},
    "world": {Role.OBSERVER: READ, Role.PLANNER: READ, Role.OPERATOR: READ, Role.WORKER: (*READ, m.Commit)},
    "workers": {Role.WORKER: JOIN},
    "subsystems": {Role.SUBSYSTEM: PERFORM},
}
TCP_DOORS = tuple(MAY)


def admits(door: str, role: Role) -> bool:
    """Whether a role has any business at a door."""
    return role in MAY.get(door, {})


def may_say(door: str, role: Role, message: object) -> bool:
    return isinstance(message, MAY.get(door, {}).get(role, NOTHING))


def no_sentence_for_a_planner(parsed: ParsedCommand, is_its_own: Callable[[str], bool]) -> str:
    """Why a planner may not say this sentence; empty when it may. Anybody who can move an arm may halt everything; but
    what somebody else has paused stays paused, and what the operator is asked the operator answers."""
    if parsed.kind == "operator":
        return f"{parsed.verb} is the operator's to say"
    if parsed.verb == "LOAD":
        return "a planner changes no program"
    if parsed.kind == "control" and parsed.verb != "HALT" and not is_its_own(parsed.object or ""):
        return f"a planner says {parsed.verb} to commands of its own only, by their number (HALT it may say to all)"
    return ""
