"""HALT requests: from a halt socket, or as a sentence. Pure."""

from __future__ import annotations

from broker.decisions.command.limits import rest_limit_s
from broker.decisions.command.scope import has_ended, in_scope, no_target, subsystem_of
from broker.decisions.command.termination import end, refuse
from broker.decisions.context import DecisionContext
from broker.decisions.effects import SendHalt
from broker.decisions.events import Stimulus
from broker.decisions.state import Command, Link, PendingOutcome
from rtc.protocol.messages import Phase
from rtc.protocol.outcomes import OutcomeKind, StopReason


def halt_by_command(context: DecisionContext, command: Command, scope: str) -> None:
    """Start a HALT sentence. It ends when rest is confirmed; its own halt does not stop it."""
    if scope != "ALL" and not subsystem_of(context, scope) and not in_scope(context, scope):
        if has_ended(context, scope):
            end(context, command, OutcomeKind.SUCCEEDED, message=f"{scope} has already ended: it moves nothing")
        else:
            refuse(context, command, no_target(context, scope, command.id))
        return
    target = context.state.commands.get(scope)
    if target is not None and not target.subsystem:
        context.follow(scope, Stimulus.STOP, _halted(scope))
        end(context, command, OutcomeKind.SUCCEEDED, message=f"{scope} had moved nothing yet")
        return
    command.pending_outcome = PendingOutcome(kind=OutcomeKind.SUCCEEDED, message=f"{scope} at rest")
    context.enter(command, Phase.HALTING, f"halt {scope}")
    context.start_timer(command, rest_limit_s(context.state))
    halt(context, command.id, scope, context.now, spare=command.id)
    command.unconfirmed = [e.subsystem for e in context.effects if type(e) is SendHalt and e.halt == command.id]


def halt(
    context: DecisionContext,
    halt_id: str,
    scope: str,
    called_at_s: float,
    spare: str = "",
    call: str = "",
    received_at_s: float = 0.0,
) -> bool:
    """Halt the subsystems in scope, then stop the commands. False: the scope is unknown.

    A subsystem may forward a halt late, after an absence of the broker. Its time of receipt, if known, then parts the
    commands: those sent later go on. They have not begun to move there, because the subsystem fenced the scope."""
    state = context.state
    targets = in_scope(context, scope)
    performer = subsystem_of(context, scope)
    if scope != "ALL" and not targets and not performer:
        return False
    if scope not in state.commands:
        at_s = min(called_at_s or context.now, context.now)
        state.halted_at_s[scope] = max(at_s, state.halted_at_s.get(scope, 0.0))  # an earlier halt may arrive later
    for name, subsystem in state.subsystems.items():
        concerned = scope == "ALL" or name == performer or any(c.subsystem == name for c in targets)
        if concerned and subsystem.link is not Link.LOST:
            context.effects.append(
                SendHalt(subsystem=name, halt=halt_id, scope=scope, called_at_s=called_at_s, call=call)
            )
    for command in targets:
        if command.id != spare and not _was_sent_after(command, received_at_s):
            context.follow(command.id, Stimulus.STOP, _halted(scope))
    return True


def _was_sent_after(command: Command, received_at_s: float) -> bool:
    """Whether a command was sent after a subsystem received a halt. A sender that gives no time, or a time in the
    future, has `given_at_s` equal to `accepted_at_s`: it may have been sent earlier."""
    return 0.0 < received_at_s < command.given_at_s < command.accepted_at_s


def _halted(scope: str) -> PendingOutcome:
    return PendingOutcome(kind=OutcomeKind.HALTED, message=f"halted ({scope})", stop=StopReason.HALT)
