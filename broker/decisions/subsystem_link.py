"""The link of a subsystem to the broker: connected, awaited after a restart of the broker, or lost. Pure.

A subsystem executes its primitives without the broker. On each connection it lists those it still has. The broker sends
again what never arrived, or halts what no command waits for any more.
"""

from __future__ import annotations

from enum import StrEnum

from broker.decisions import halt_request
from broker.decisions.command import nominal, operator_answers, pacing, stopping
from broker.decisions.context import DecisionContext
from broker.decisions.effects import SendHalt
from broker.decisions.events import BrokerRestarted, Stimulus, SubsystemConnected, SubsystemGone
from broker.decisions.machine import Ignored, Machine, TableCell, cell
from broker.decisions.state import NIL, LinkState, State, SubsystemState
from rtc.protocol.messages import HaltOrder, Phase, SubsystemHello
from rtc.protocol.primitive_id import command_of, number_of
from rtc.protocol.versions import PAUSES, RIGID

MAX_SUBSYSTEMS = 32  # maximum number of subsystems in the state, lost ones included


class LinkStimulus(StrEnum):
    """What an event means to the link of a subsystem."""

    HELLO = "hello"  # the process connects: the one known so far, or the first one
    NEW_PROCESS = "new_process"  # another process connects in place of the one known so far
    GONE = "gone"  # the connection is lost, or the process has ended
    BROKER_RESTARTED = "broker_restarted"


def on_hello(context: DecisionContext, event: SubsystemConnected) -> None:
    hello = event.hello
    known = context.state.subsystems.get(hello.name)
    same = known is None or known.pid == hello.pid
    LINK.run(context, hello.name, LinkStimulus.HELLO if same else LinkStimulus.NEW_PROCESS, hello)


def on_gone(context: DecisionContext, event: SubsystemGone) -> None:
    LINK.run(context, event.subsystem, LinkStimulus.GONE, event)


def on_broker_restarted(context: DecisionContext, event: BrokerRestarted) -> None:
    for name in context.state.subsystems:
        LINK.run(context, name, LinkStimulus.BROKER_RESTARTED, event)


# --- actions -----------------------------------------------------------------------------------------


def register(context: DecisionContext, name: str, hello: SubsystemHello) -> None:
    """Connect a new subsystem, or decline it if there are too many."""
    state = context.state
    if len(state.subsystems) >= MAX_SUBSYSTEMS and not _forget_one(state):
        context.count("subsystems_declined")
    else:
        _connect(context, hello)


def reconnect(context: DecisionContext, name: str, hello: SubsystemHello) -> None:
    """Connect the same process again. A primitive that it does not list never arrived."""
    _connect(context, hello)
    state = context.state
    for command in state.commands.values():
        if command.subsystem == name and command.primitive_body != NIL:
            if command.phase is Phase.HALTING:
                stopping.order_halt(context, command)
            elif command.phase is Phase.EXECUTING and command.primitive not in hello.outstanding:
                nominal.send(context, command)
            elif command.phase is Phase.EXECUTING and command.pause_wanted is not (command.primitive in hello.paused):
                pacing.send_pace(context, command)  # the order was lost
            for answer in state.answers.values():
                if answer.primitive == command.primitive:
                    operator_answers.send(context, command, answer)


def replace(context: DecisionContext, name: str, hello: SubsystemHello) -> None:
    """Connect a new process. The primitives of the former one died with it."""
    _stop_users(context, name, "it was restarted")
    _connect(context, hello)


def lose(context: DecisionContext, name: str, event: SubsystemGone) -> None:
    subsystem = context.state.subsystems[name]
    subsystem.link = LinkState.LOST
    subsystem.came_at_rest = False
    context.count("subsystems_lost")
    _stop_users(context, name, event.why)


def await_hello(context: DecisionContext, name: str, event: BrokerRestarted) -> None:
    context.state.subsystems[name].link = LinkState.AWAITED


def _connect(context: DecisionContext, hello: SubsystemHello) -> None:
    """Store the link, and halt what moves there without a command that waits for it."""
    state, name = context.state, hello.name
    state.subsystems[name] = SubsystemState(
        pid=hello.pid,
        performers=hello.performers,
        queues=hello.queues,
        came_at_rest=hello.at_rest,
        pauses=PAUSES in hello.abilities,
        rigid=RIGID in hello.abilities,
    )
    for primitive in hello.outstanding:
        state.accepted = max(state.accepted, number_of(primitive))  # a journal after a loss may lack it
        owner = command_of(primitive)
        command = state.commands.get(owner)
        # A live command may still execute a primitive that was given up; other entries are unacknowledged reports.
        if command is None or (command.phase is Phase.CLOSING and not command.at_rest):
            _order_halt(context, name, f"orphan-{primitive}", owner)
    if hello.at_rest:
        context.confirm_rest(name)
    elif not hello.outstanding:
        _order_halt(context, name, f"rejoin-{name}-{context.now:.6f}", "ALL")


def _order_halt(context: DecisionContext, subsystem: str, halt: str, scope: str) -> None:
    order = HaltOrder(halt=halt, scope=scope, called_at_s=context.now)
    context.effects.append(SendHalt(subsystem=subsystem, order=order))


def _stop_users(context: DecisionContext, name: str, why: str) -> None:
    """Stop every command that has used this subsystem: a global error (A30). Its rest is not confirmed either."""
    for command in context.state.commands.values():
        if command.subsystem == name:
            context.enqueue_stimulus(command.id, Stimulus.SUBSYSTEM_LOST, why)
    halt_request.on_subsystem_lost(context, why)


def _forget_one(state: State) -> bool:
    """Delete one lost subsystem that nothing waits for. False: there is none."""
    wanted = {c.subsystem for c in state.commands.values()} | {q.subsystem for q in state.resources.quarantine.values()}
    lost = (name for name, s in state.subsystems.items() if s.link is LinkState.LOST and name not in wanted)
    return state.subsystems.pop(next(lost, ""), None) is not None


# --- table -------------------------------------------------------------------------------------------

S, L = LinkStimulus, LinkState

_ROWS: dict[LinkState, dict[LinkStimulus, TableCell[LinkState]]] = {
    L.UNKNOWN: {
        S.HELLO: cell(register, L.CONNECTED, L.UNKNOWN),
    },
    L.CONNECTED: {
        S.HELLO: cell(reconnect, L.CONNECTED),
        S.NEW_PROCESS: cell(replace, L.CONNECTED),
        S.GONE: cell(lose, L.LOST),
        S.BROKER_RESTARTED: cell(await_hello, L.AWAITED),
    },
    L.AWAITED: {
        S.HELLO: cell(reconnect, L.CONNECTED),
        S.NEW_PROCESS: cell(replace, L.CONNECTED),
        S.GONE: cell(lose, L.LOST),
    },
    L.LOST: {
        S.HELLO: cell(reconnect, L.CONNECTED),
        S.NEW_PROCESS: cell(replace, L.CONNECTED),
    },
}
_IGNORED: list[Ignored[LinkState, LinkStimulus]] = [
    Ignored([L.UNKNOWN], [S.NEW_PROCESS, S.GONE, S.BROKER_RESTARTED], "it has never connected, or is forgotten"),
    Ignored([L.AWAITED], [S.BROKER_RESTARTED], "it is awaited already"),
    Ignored([L.LOST], [S.GONE, S.BROKER_RESTARTED], "it is lost already, until it connects"),
]


def link_of(state: State, name: str) -> LinkState:
    subsystem = state.subsystems.get(name)
    return L.UNKNOWN if subsystem is None else subsystem.link


LINK = Machine(LinkState, LinkStimulus, _ROWS, _IGNORED, first=L.UNKNOWN, state_of=link_of)
