"""Loss of journal records: every command accepted in the lost decisions gets a true outcome.

The effects of the lost decisions are unknown. Command numbers continue above the highest known one, and primitive ids
get a new life. Live commands end as failed and leave their facts suspect. A client that waits for a lost command gets
that outcome too. A sentence sent before the loss is not started, because it may have been executed already.
"""

from __future__ import annotations

from broker.decisions.command.termination import end
from broker.decisions.context import DecisionContext
from broker.decisions.effects import PublishNote
from broker.decisions.events import JournalLost, Stimulus
from broker.decisions.state import Command, PendingOutcome, State
from rtc.protocol.advice import by_person
from rtc.protocol.messages import CommandText, NoteKind, Phase, ProgressNote
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason, StopReason

JOB_NUMBER_GAP = 10_000  # offset of job numbers after the loss, so that they differ from lost ones
MAX_NUMBER_AHEAD = 1_000_000  # a client's number is accepted up to this far above the known ones
CLEARS = "check what was done, then give it again"


def on_journal_lost(context: DecisionContext, event: JournalLost) -> None:
    state = context.state
    state.life, state.lost, state.lost_at_s = event.life, event.why, event.at_s
    state.accepted = max(state.accepted, event.accepted)
    context.count("journals_lost")
    over = PendingOutcome(kind=OutcomeKind.FAILED, message=f"{event.why}; {CLEARS}", stop=StopReason.SUBSYSTEM_LOST)
    for command in state.commands.values():
        command.jobs += JOB_NUMBER_GAP
        context.enqueue_stimulus(command.id, Stimulus.STOP, over)


def is_lost(state: State, sentence: CommandText) -> bool:
    """True if an unknown request belongs to the lost decisions: its client has a number for it, or sent it before the
    loss."""
    return bool(state.lost) and (bool(sentence.known_as) or 0 < sentence.sent_at_s <= state.lost_at_s)


def unknown_number(state: State, sentence: CommandText) -> Refusal | None:
    """Refuse an unknown request that has a number although no decision was lost: the number cannot be its own, or its
    outcome is no longer kept. The record of the command with that number must not be replaced."""
    if not sentence.known_as or state.lost:
        return None
    if 0 < number_of(sentence.known_as) <= state.accepted:
        message = f"{sentence.known_as} is another request, or its outcome is no longer kept; nothing is begun"
        clears = f"`rtc trace {sentence.known_as}` shows that command; without known_as the sentence is a new one"
    else:
        message = f"no command was accepted as {sentence.known_as[:40]}; nothing is begun"
        clears = "leave known_as out: the sentence is then a new command"
    return Refusal(reason=RefusalReason.STATE, message=message, where="known_as", clears=by_person(clears))


def number_of(name: str) -> int:
    """n of the command number C-n; 0 if it is none."""
    digits = name.removeprefix("C-")
    number = int(digits[:18]) if digits.isascii() and digits.isdigit() else 0
    return number if name == f"C-{number}" else 0


def new_number(state: State, sentence: CommandText) -> str:
    """The next command number; after a loss the one known to the client, if it is free."""
    name, number = sentence.known_as, number_of(sentence.known_as) if state.lost else 0
    taken = name in state.commands or name in state.ended
    free = 0 < number <= state.accepted + MAX_NUMBER_AHEAD and not taken
    if not free:
        number = state.accepted + 1
    state.accepted = max(state.accepted, number)
    return f"C-{number}"


def end_lost(context: DecisionContext, command: Command) -> None:
    """End a lost command as failed."""
    end(
        context,
        command,
        PendingOutcome(OutcomeKind.FAILED, f"{context.state.lost}: how far it came is not known; {CLEARS}"),
    )


def publish(context: DecisionContext) -> None:
    """Publish the loss to the subscribers of the event stream."""
    state = context.state
    if state.lost:
        state.seq += 1
        kind = NoteKind.JOURNAL_LOST
        note = ProgressNote(
            seq=state.seq, at_s=context.now, command="", phase=Phase.ENDED, kind=kind, message=state.lost
        )
        context.effects.append(PublishNote(client="", note=note))
