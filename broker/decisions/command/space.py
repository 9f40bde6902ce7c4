"""A command that waits until another arm leaves the space that it needs. Pure.

A planner refuses a motion and names the arm in its way. Or the subsystem has not started a motion, or has stopped it on
its way, because another arm did not leave in time. If another live command owns that arm, the command keeps what it
holds and waits. When that arm has rested, or its owner has ended, it plans again. A wait that would close a circle is
refused. So a chain of such waits always ends in a command that can go on. There is no deadlock, although a command
holds its claims while it waits. A command in the line of a resource holds nothing, so it is in no such chain.
"""

from __future__ import annotations

from typing import Any

import msgspec

from broker.decisions.command import nominal
from broker.decisions.command.claims import start_elaboration, without_now
from broker.decisions.command.closing import read_assessment
from broker.decisions.command.nominal import bind_step
from broker.decisions.command.termination import refuse
from broker.decisions.context import DecisionContext
from broker.decisions.state import Command
from rtc.protocol.advice import by_person, by_sentence, in_order
from rtc.protocol.messages import EndReport, NoteKind, Phase
from rtc.protocol.outcomes import Refusal, RefusalReason, StopReason


def on_refused(context: DecisionContext, command: Command, refusal: Refusal) -> None:
    """Wait for the arm in the way, if it can be expected to leave; otherwise end the command."""
    command.job = None
    arm = refusal.in_the_way
    if not arm:
        refuse(context, command, refusal)
        return
    if command.motions_seen != (context.state.motions_begun, context.state.motions_ended):
        plan_again(context, command, None)  # the plan was made for motions that have changed
        return
    _wait(context, command, arm, refusal)


def on_reported(context: DecisionContext, command: Command, report: EndReport) -> None:
    """Plan again after a motion that was not started; wait first while the arm in its way is still on its path.

    A motion that was stopped on its way is analyzed first, so that the world has its position."""
    if report.reason is not StopReason.BLOCKED or report.duration_s > 0.0:
        nominal.on_reported(context, command, report)
        return
    context.stop_timer(command)
    nominal.acknowledge(context, command)
    context.end_motions(command)
    _after_blocked(context, command, f"nothing has moved: {report.message}")


def on_assessed(context: DecisionContext, command: Command, product: msgspec.Raw) -> None:
    """Plan a motion again that was stopped on its way: the world has its position now."""
    assessment = read_assessment(product)
    if assessment.reason is not StopReason.BLOCKED:
        nominal.on_assessed(context, command, assessment)
        return
    context.end_motions(command)
    _after_blocked(context, command, assessment.message or "stopped on its way")


def _after_blocked(context: DecisionContext, command: Command, message: str) -> None:
    """Plan the step again, once the arm in its way is not on that path any more."""
    arms = [arm for arm, motion in context.state.motions.items() if motion.primitive in command.beside]
    if not arms:
        bind_step(context, command, NoteKind.PLANNED_AGAIN, message=message)
        return
    refusal = Refusal(reason=RefusalReason.INFEASIBLE, message=message, clears=by_person(f"wait for {arms[0]}"))
    _wait(context, command, arms[0], refusal)


def _wait(context: DecisionContext, command: Command, arm: str, refusal: Refusal) -> None:
    owner = context.owner_of(arm)
    if owner is None or owner is command:
        refuse(context, command, refusal)
    elif circle := _circle(context, command, owner):
        message = f"{refusal.message}; {command.id} cannot wait for {owner.id}: {circle}"
        clears = in_order(by_sentence(f"ABORT {owner.id}"), refusal.clears or by_person(f"move {arm}"))
        refuse(context, command, msgspec.structs.replace(refusal, message=message, owner=owner.id, clears=clears))
    elif command.head is not None and command.head.now:
        message = f"{refusal.message}, {arm} is in use by {owner.id}, and the sentence contains NOW"
        clears = without_now(owner.id)
        now = Refusal(reason=RefusalReason.RESOURCE, message=message, owner=owner.id, clears=clears)
        refuse(context, command, now)
    else:
        command.waits_for = arm
        context.state.space_lines.setdefault(arm, []).append(command.id)
        context.enter(command, Phase.WAITING, NoteKind.SPACE, arm=arm, owner=owner.id, message=refusal.message)


def _circle(context: DecisionContext, command: Command, owner: Command) -> str:
    """The chain of waits from `owner` back to `command`, in words; empty if there is none."""
    words = []
    while owner.phase is Phase.WAITING:
        words.append(f"{owner.id} waits for space of {owner.waits_for}")
        following = context.owner_of(owner.waits_for)
        if following is command:
            return ", ".join(words)
        if following is None:
            return ""
        owner = following
    return ""


def plan_again(context: DecisionContext, command: Command, _: Any) -> None:
    """Repeat the job that was refused, with what other arms do now."""
    context.leave_space_line(command)
    if command.actions is None:
        start_elaboration(context, command)
    else:
        bind_step(context, command)


def pause(context: DecisionContext, command: Command, _: Any) -> None:
    """Pause before the step that waits. A command without a plan pauses before its first step."""
    command.pause_wanted = True
    if command.actions is None:
        context.note(command, NoteKind.WILL_PAUSE_FIRST)
    else:
        plan_again(context, command, None)
