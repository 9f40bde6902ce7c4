"""PAUSE, RESUME and ABORT of commands. A HALT sentence is passed to its own machine. Pure."""

from __future__ import annotations

from typing import Any

from broker.decisions.command.nominal import take_step
from broker.decisions.command.pacing import can_pause
from broker.decisions.command.scope import has_ended, in_scope, no_target, scope_of, subsystem_of
from broker.decisions.command.surrender import is_held
from broker.decisions.command.termination import end, refuse
from broker.decisions.context import DecisionContext
from broker.decisions.events import Stimulus
from broker.decisions.halt_request import Settled, on_sentence, order
from broker.decisions.resources import number
from broker.decisions.state import Command, ParsedHead, PendingOutcome, path_words
from rtc.protocol.advice import Advice, by_person, by_sentence
from rtc.protocol.messages import HaltOrder, NoteKind, Phase
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason

CONTROLS = {"PAUSE": Stimulus.PAUSE, "RESUME": Stimulus.RESUME, "ABORT": Stimulus.STOP}  # all control verbs except HALT


def concerns_earlier(head: ParsedHead) -> bool:
    """True for PAUSE, RESUME and ABORT of an arm: the client's earlier commands must be parsed to know which use it.
    HALT does not wait; ALL and a number need no parsed commands."""
    scope = scope_of(head)
    return head.verb != "HALT" and scope != "ALL" and not scope.startswith("C-")


def control(context: DecisionContext, command: Command, head: ParsedHead) -> None:
    """Apply PAUSE, RESUME, ABORT or HALT to one command, to the users of a resource, or to all."""
    scope = scope_of(head)
    if head.verb == "HALT":
        halt_sentence(context, command, scope)
        return
    if head.verb not in CONTROLS:
        message = f"the grammar lists {head.verb!r:.80} as a control verb, which it is not"
        refuse(context, command, Refusal(reason=RefusalReason.PROGRAM, message=message))
        return
    targets = [c.id for c in in_scope(context, scope) if c.id == scope or not _given_after(c, command)]
    if not targets and scope != "ALL" and not subsystem_of(context, scope):
        refuse(context, command, no_target(context, scope, command.id))
        return
    stimulus = CONTROLS[head.verb]
    words = f"{head.verb} of {', '.join(targets)}" if targets else f"{head.verb} had nothing to act on"
    if answer := PAUSE_ANSWERS.get(stimulus):
        answers = {name: answer(context, context.state.commands[name]) for name in targets}
        targets = [name for name, (will, _) in answers.items() if will]
        words = "; ".join(f"{name} {what}" for name, (_, what) in answers.items()) or words
        if not targets:
            clears = _instead(context, scope, list(answers)) if stimulus is Stimulus.PAUSE else RESUME_ADVICE
            refuse(context, command, Refusal(reason=RefusalReason.STATE, message=words, clears=clears))
            return
    ending = PendingOutcome(kind=OutcomeKind.ABORTED, message=f"aborted by {command.id}")
    for target in targets:
        context.enqueue_stimulus(target, stimulus, ending if stimulus is Stimulus.STOP else None)
    end(context, command, PendingOutcome(OutcomeKind.SUCCEEDED, words))


def halt_sentence(context: DecisionContext, command: Command, scope: str) -> None:
    """Start a HALT sentence; end it at once if its scope has moved nothing. One of an unknown name halts ALL."""
    if scope != "ALL" and not subsystem_of(context, scope) and not in_scope(context, scope):
        if has_ended(context, scope):
            end(context, command, PendingOutcome(OutcomeKind.SUCCEEDED, f"{scope} has already ended: it moves nothing"))
        else:
            on_sentence(context, command, "ALL", unknown=scope)
        return
    target = context.state.commands.get(scope)
    if target is not None and not target.subsystem:
        order(context, HaltOrder(halt=command.id, scope=scope, called_at_s=context.now), spare=command.id)
        end(context, command, PendingOutcome(OutcomeKind.SUCCEEDED, f"{scope} had moved nothing yet"))
        return
    on_sentence(context, command, scope)


def end_halt(context: DecisionContext, command: Command, settled: Settled) -> None:
    """End a HALT sentence. It has touched nothing itself."""
    del context.state.halt_sentences[command.id]
    outcome, context.node = settled
    end(context, command, outcome)


def _given_after(other: Command, command: Command) -> bool:
    """True if the same client gave `other` at or after `command`. A PAUSE does not concern it, even if it is parsed."""
    return other.client == command.client and number(other.id) >= number(command.id)


Answer = tuple[bool, str]  # (is the request accepted?, what the command does, in words)


def _will_pause(context: DecisionContext, command: Command) -> Answer:
    """Whether a command can pause: on the path of its motion if its subsystem can do that, else between two steps."""
    if _is_paused(command):
        return False, "is paused already" + (f": it {path_words(command.paused_done)}" if command.stands else "")
    if command.phase in (Phase.HALTING, Phase.CLOSING):
        return False, "is ending"
    if command.phase is Phase.REHEARSING:
        return False, "is a test, which moves nothing"
    if command.phase is Phase.WAITING and command.actions is not None:
        return True, f"pauses before step {command.step_words}"
    if command.actions is None or command.actions.step is None:
        return True, "pauses before its first step"
    if command.phase is Phase.EXECUTING and can_pause(context, command):
        return True, f"slows down on its path and pauses, in step {command.step_words}"
    if command.actions.refs:
        return True, f"pauses after step {command.step_words}"
    return False, f"is in its last step ({command.step_words}) and ends with it"


def _is_paused(command: Command) -> bool:
    return command.phase is Phase.PAUSED or (command.stands and command.pause_wanted)


def _instead(context: DecisionContext, scope: str, targets: list[str]) -> Advice:
    """The remedy after a refused PAUSE."""
    if not targets:
        return by_person("PAUSE while something moves")
    if any(_is_paused(context.state.commands[target]) for target in targets):
        return by_sentence(f"RESUME {scope}", words="it goes on then")
    return by_sentence(f"HALT {scope}", words="stops now, and ends it", instead=True)


def _will_resume(context: DecisionContext, command: Command) -> Answer:
    if command.phase in (Phase.HALTING, Phase.CLOSING):
        return False, "is ending"
    if command.phase is Phase.REHEARSING:
        return False, "is a test, which moves nothing"
    going = command.phase is not Phase.PAUSED and not command.pause_wanted and not command.single_step
    going = going and not is_held(context, command.id)
    return (False, "was not paused") if going else (True, "goes on")


RESUME_ADVICE = by_person("RESUME a command that is paused: rtc status lists the commands in progress")
PAUSE_ANSWERS = {Stimulus.PAUSE: _will_pause, Stimulus.RESUME: _will_resume}


def request_pause(context: DecisionContext, command: Command, _: Any) -> None:
    command.pause_wanted = True
    context.note(command, NoteKind.WILL_PAUSE)


def withdraw_pause(context: DecisionContext, command: Command, _: Any) -> None:
    command.pause_wanted = command.single_step = False


def resume(context: DecisionContext, command: Command, _: Any) -> None:
    """Go on with the next step, whatever breakpoint is before it."""
    command.pause_wanted = command.single_step = False
    context.note(command, NoteKind.RESUMED)
    take_step(context, command)


def step(context: DecisionContext, command: Command, _: Any) -> None:
    """Perform the next step, and pause again."""
    command.pause_wanted, command.single_step = False, True
    take_step(context, command)
