"""The request of a halt: from a halt socket, or as a HALT sentence. Pure.

Both halt the subsystems in scope and stop the commands there. The router forwards each confirmation to the caller at a
socket. A HALT sentence is a command: it ends when every subsystem has confirmed rest, or one has failed to.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

import msgspec

from broker.decisions.command.limits import await_rest, rest_limit_s
from broker.decisions.command.scope import behind, has_ended, in_scope, no_target, subsystem_of
from broker.decisions.context import DecisionContext
from broker.decisions.effects import DeclineHalt, PublishHalt, SendHalt
from broker.decisions.events import HaltCalled, Stimulus
from broker.decisions.machine import Ignored, Machine, TableCell, cell
from broker.decisions.state import Command, HaltPhase, HaltSentence, LinkState, PendingOutcome, State
from rtc.protocol.messages import HaltOrder, HaltRequested, NoteKind, Phase
from rtc.protocol.outcomes import OutcomeKind, StopReason

HALTS_KEPT = 64  # latest halts from sockets stored, to count each once


class HaltStimulus(StrEnum):
    """What an event means to a request of a halt."""

    CALL = "call"  # it arrives from a halt socket, or from a subsystem that received it at its own; payload: the event
    SENTENCE = "sentence"  # it is a command; payload: the scope
    REST = "rest"  # a subsystem confirms that all in scope is at rest; payload: its name
    MOVING = "moving"  # a subsystem reports that something in scope still moves; payload: its name
    SUBSYSTEM_LOST = "subsystem_lost"  # payload: why
    TIMEOUT = "timeout"


def on_call(context: DecisionContext, event: HaltCalled) -> None:
    """Most calls arrive twice, because a caller sends them to the broker and to the subsystem."""
    order = event.order
    HALT.run(context, f"{order.halt} {order.scope} {order.called_at_s}", HaltStimulus.CALL, event)


def on_sentence(context: DecisionContext, command: Command, scope: str, unknown: str = "") -> None:
    """`unknown`: the name that nothing has, for which ALL is halted."""
    HALT.run(context, command.id, HaltStimulus.SENTENCE, scope)
    context.state.halt_sentences[command.id].unknown = unknown


def on_confirmed(context: DecisionContext, name: str, subsystem: str, at_rest: bool) -> None:
    HALT.run(context, name, HaltStimulus.REST if at_rest else HaltStimulus.MOVING, subsystem)


def on_subsystem_lost(context: DecisionContext, why: str) -> None:
    for name in list(context.state.halt_sentences):
        HALT.run(context, name, HaltStimulus.SUBSYSTEM_LOST, why)


def on_timeout(context: DecisionContext, name: str) -> None:
    HALT.run(context, name, HaltStimulus.TIMEOUT)


# --- from a socket -----------------------------------------------------------------------------------


def obey_call(context: DecisionContext, name: str, event: HaltCalled) -> None:
    context.count("halts")
    refused = _order_or_decline(context, name, event)
    if context.state.has_subscribers:
        called = event.order
        halt = HaltRequested(
            at_s=context.now, halt=called.halt, scope=called.scope, called_at_s=called.called_at_s, refused=refused
        )
        context.effects.append(PublishHalt(halt=halt))


def repeat_call(context: DecisionContext, name: str, event: HaltCalled) -> None:
    """Obey a halt whose name was used before: two callers may both count from one, and a button may always send the
    same name."""
    _order_or_decline(context, name, event)


def _order_or_decline(context: DecisionContext, name: str, event: HaltCalled) -> str:
    """Why nothing was halted; otherwise empty."""
    called, from_subsystem = event.order, event.client in context.state.subsystems
    known = order(context, called)
    # A halt of an ended command is valid: the subsystems confirm rest, so it is not declined.
    declined = not known and not from_subsystem and not has_ended(context, called.scope)
    message = ""
    if declined:
        refusal = no_target(context, called.scope)
        message = f"{refusal.message}; expected: {', '.join(refusal.expected)}"
        context.effects.append(DeclineHalt(client=event.client, halt=called.halt, message=message))
    if from_subsystem and not any(type(e) is SendHalt and e.subsystem == event.client for e in context.effects):
        # The subsystem starts nothing in the scope until it receives this acknowledgement.
        context.effects.append(SendHalt(subsystem=event.client, order=called))
    halts = context.state.halts
    halts[name] = HaltPhase.DECLINED if declined else HaltPhase.FORWARDED
    if len(halts) > HALTS_KEPT:
        del halts[next(iter(halts))]
    return message


def order(context: DecisionContext, called: HaltOrder, spare: str = "") -> bool:
    """Halt the subsystems in scope, then stop the commands, except `spare`. False: the scope is unknown.

    With a command those end that wait for what it holds: after a halt nothing begins by itself (decision 0174).
    A subsystem may forward a halt late, after an absence of the broker. Its time of receipt, if known, then parts the
    commands: those sent later go on. They have not begun to move there, because the subsystem fenced the scope."""
    state, scope = context.state, called.scope
    targets = in_scope(context, scope)
    performer = subsystem_of(context, scope)
    if scope != "ALL" and not targets and not performer:
        return False
    halted_names = [scope]
    if scope in state.commands:
        halted_names = [name for name, exclusive in state.resources.held.get(scope, {}).items() if exclusive]
        targets = [*targets, *behind(context, targets[0])]
    at_s = min(called.called_at_s or context.now, context.now)
    for name in halted_names:
        state.halted_at_s[name] = max(at_s, state.halted_at_s.get(name, 0.0))  # an earlier halt may arrive later
    for name, subsystem in state.subsystems.items():
        if subsystem.link is not LinkState.LOST:
            orders = [called] if scope == "ALL" or name == performer else _of_commands(called, targets, name)
            context.effects += [SendHalt(subsystem=name, order=one) for one in orders]
    for command in targets:
        if command.id != spare and not _was_sent_after(command, called.received_at_s):
            context.enqueue_stimulus(command.id, Stimulus.STOP, halted(scope))
    return True


def _of_commands(called: HaltOrder, targets: list[Command], subsystem: str) -> list[HaltOrder]:
    """The orders for a subsystem without a performer of that name: it knows commands, and no objects. One of which no
    subsystem has anything is confirmed by each, so that the caller gets an answer."""
    concerned = [c.id for c in targets if c.subsystem == subsystem]
    if called.scope not in (c.id for c in targets):
        concerned = concerned or [c.id for c in targets[:1] if not any(c.subsystem for c in targets)]
    return [msgspec.structs.replace(called, scope=one) for one in concerned]


def _was_sent_after(command: Command, received_at_s: float) -> bool:
    """Whether a command was sent after a subsystem received a halt. A sender that gives no time, or a time in the
    future, has `given_at_s` equal to `accepted_at_s`: it may have been sent earlier."""
    return 0.0 < received_at_s < command.given_at_s < command.accepted_at_s


def halted(scope: str) -> PendingOutcome:
    return PendingOutcome(kind=OutcomeKind.HALTED, message=f"halted ({scope})", stop=StopReason.HALT, scope=scope)


class Settled(NamedTuple):
    """The outcome of a HALT sentence, and the subsystem whose answer decided it, if one did."""

    outcome: PendingOutcome
    node: str


# --- as a sentence -----------------------------------------------------------------------------------


def order_sentence(context: DecisionContext, name: str, scope: str) -> None:
    """Halt what is in scope, except the HALT sentence itself, and wait for rest."""
    command = context.state.commands[name]
    context.enter(command, Phase.HALTING, NoteKind.HALT, about=scope)
    await_rest(context, command, list(context.state.subsystems))
    order(context, HaltOrder(halt=name, scope=scope, called_at_s=context.now), spare=name)
    ordered = [e.subsystem for e in context.effects if type(e) is SendHalt and e.order.halt == name]
    context.state.halt_sentences[name] = HaltSentence(scope=scope, unconfirmed=ordered)


def confirm(context: DecisionContext, name: str, subsystem: str) -> None:
    """Settle the request when the last subsystem confirms rest. Others may confirm twice."""
    request = context.state.halt_sentences[name]
    if subsystem in request.unconfirmed:
        request.unconfirmed.remove(subsystem)
        if not request.unconfirmed:
            why = f": nothing that lives is named {request.unknown}" if request.unknown else ""
            _settle(context, name, PendingOutcome(kind=OutcomeKind.SUCCEEDED, message=f"{request.scope} at rest{why}"))


def fail_moving(context: DecisionContext, name: str, subsystem: str) -> None:
    if subsystem in context.state.halt_sentences[name].unconfirmed:
        _fail(context, name, f"{subsystem} is not at rest")


def fail_lost(context: DecisionContext, name: str, why: str) -> None:
    _fail(context, name, f"a subsystem was lost before it confirmed rest: {why}", StopReason.SUBSYSTEM_LOST)


def fail_overdue(context: DecisionContext, name: str, _: None) -> None:
    who = ", ".join(context.state.halt_sentences[name].unconfirmed) or "any subsystem"
    limit_s = rest_limit_s(context.state)
    _fail(context, name, f"halted, but rest was not confirmed by {who} within {limit_s:.0f} s", StopReason.HALT)


def _fail(context: DecisionContext, name: str, message: str, stop: StopReason | None = None) -> None:
    _settle(context, name, PendingOutcome(kind=OutcomeKind.HALT_NOT_CONFIRMED, message=message, stop=stop))


def _settle(context: DecisionContext, name: str, outcome: PendingOutcome) -> None:
    """Let the command end. Its request is removed with it."""
    context.state.halt_sentences[name].settled = True
    context.stop_timer(context.state.commands[name])
    context.enqueue_stimulus(name, Stimulus.HALT_SETTLED, Settled(outcome, context.node))


# --- table -------------------------------------------------------------------------------------------

S, H = HaltStimulus, HaltPhase

_ROWS: dict[HaltPhase, dict[HaltStimulus, TableCell[HaltPhase]]] = {
    H.NEW: {
        S.CALL: cell(obey_call, H.FORWARDED, H.DECLINED),
        S.SENTENCE: cell(order_sentence, H.AWAITING_REST),
    },
    H.FORWARDED: {S.CALL: cell(repeat_call, H.FORWARDED, H.DECLINED)},
    H.DECLINED: {S.CALL: cell(repeat_call, H.FORWARDED, H.DECLINED)},
    H.AWAITING_REST: {
        S.REST: cell(confirm, H.AWAITING_REST, H.SETTLED),
        S.MOVING: cell(fail_moving, H.AWAITING_REST, H.SETTLED),
        S.SUBSYSTEM_LOST: cell(fail_lost, H.SETTLED),
        S.TIMEOUT: cell(fail_overdue, H.SETTLED),
    },
    H.SETTLED: {},
}
_ANSWERS = (S.REST, S.MOVING, S.SUBSYSTEM_LOST, S.TIMEOUT)
_IGNORED: list[Ignored[HaltPhase, HaltStimulus]] = [
    Ignored([H.NEW], _ANSWERS, "nothing was ordered yet, or its command has ended"),
    Ignored([H.FORWARDED, H.DECLINED], _ANSWERS, "its caller receives the answers, and has a time limit of its own"),
    Ignored([H.FORWARDED, H.DECLINED], [S.SENTENCE], "a sentence has the name of its command, a call another one"),
    Ignored([H.AWAITING_REST, H.SETTLED], [S.CALL, S.SENTENCE], "a command is taken up once"),
    Ignored([H.SETTLED], _ANSWERS, "its outcome is decided"),
]


def phase_of(state: State, name: str) -> HaltPhase:
    sentence = state.halt_sentences.get(name)
    if sentence is not None:
        return H.SETTLED if sentence.settled else H.AWAITING_REST
    return state.halts.get(name, H.NEW)


HALT = Machine(HaltPhase, HaltStimulus, _ROWS, _IGNORED, first=H.NEW, state_of=phase_of)
