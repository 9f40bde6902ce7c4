"""PAUSE and RESUME of a command in motion: its subsystem pauses the primitive on its path. Pure.

The order is sent again when the subsystem connects without having received it. A subsystem that cannot pause finishes
its primitive; then the command pauses before its next step. It does the same when the primitive ends before it stands.
"""

from __future__ import annotations

from typing import Any

from broker.decisions.command.limits import await_report
from broker.decisions.command.stopping import stop_overdue
from broker.decisions.context import DecisionContext
from broker.decisions.effects import SendPace
from broker.decisions.events import PrimitivePaced
from broker.decisions.state import Command, LinkState
from rtc.protocol.messages import NoteKind, Phase
from rtc.protocol.primitive_id import command_of


def can_pause(context: DecisionContext, command: Command) -> bool:
    """Whether the subsystem of the command's primitive pauses it on its path."""
    subsystem = context.state.subsystems.get(command.subsystem)
    return subsystem is not None and subsystem.pauses


def send_pace(context: DecisionContext, command: Command) -> None:
    """Send what the command wants now. A lost or awaited subsystem receives it when it connects."""
    subsystem = context.state.subsystems.get(command.subsystem)
    if subsystem is not None and subsystem.pauses and subsystem.link is LinkState.CONNECTED:
        context.effects.append(
            SendPace(subsystem=command.subsystem, primitive=command.primitive, paused=command.pause_wanted)
        )


def pause_motion(context: DecisionContext, command: Command, _: Any) -> None:
    command.pause_wanted = True
    context.note(command, NoteKind.SLOWS_DOWN if can_pause(context, command) else NoteKind.WILL_PAUSE)
    send_pace(context, command)


def resume_motion(context: DecisionContext, command: Command, _: Any) -> None:
    """Let it go on. The time limit of the end report begins anew, because the subsystem's own does not count pauses."""
    if command.pause_wanted and can_pause(context, command):
        await_report(context, command)
    command.pause_wanted = command.single_step = False
    send_pace(context, command)


def on_overdue(context: DecisionContext, command: Command, _: Any) -> None:
    """A pause may be longer than the time limit of the end report. A hung subsystem is noticed by its heartbeat."""
    if command.pause_wanted and can_pause(context, command):
        await_report(context, command)
    else:
        stop_overdue(context, command, _)


def on_paced(context: DecisionContext, event: PrimitivePaced) -> None:
    change = event.change
    command = context.state.commands.get(command_of(change.primitive))
    awaited = command is not None and (command.primitive, command.subsystem) == (change.primitive, event.subsystem)
    if awaited and command is not None and command.phase is Phase.EXECUTING:
        context.node = event.subsystem
        command.paused_primitive = change.primitive if change.paused else ""
        command.paused_done = change.done
        if change.paused:
            context.note(command, NoteKind.STANDS, value=change.done, warning=True)  # a person sees why it waits
        else:
            context.note(command, NoteKind.GOES_ON)
