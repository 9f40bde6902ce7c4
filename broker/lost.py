"""What follows when the journal lacks turns that this run has decided: every promise in them gets a true end.

Nobody knows what the lost turns did. So the numbers go on above the highest one that anybody knows, primitives get
names of another life, what is live ends as failed and leaves its facts suspect, and a client that waits for a command
of the lost turns is told so. Nothing that was sent before is begun: it may have been done already.
"""

from __future__ import annotations

from broker.effects import PublishNote, TellClient
from broker.ending import end
from broker.events import CommandReceived, JournalLost, Stimulus
from broker.state import Command, PendingOutcome, State, request_key
from broker.turn import DecisionContext
from rtc.messages import Accepted, Phase, ProgressNote
from rtc.outcomes import OutcomeKind, StopReason

JOBS_APART = 10_000  # a command's jobs after the loss are numbered so much higher: the lost turns gave out some
FURTHEST = 1_000_000  # how far above our own numbers a client's number is believed
CLEARS = "look what was done, then give it again"


def on_journal_lost(context: DecisionContext, event: JournalLost) -> None:
    state = context.state
    state.life, state.lost, state.lost_at_s = event.life, event.why, event.at_s
    state.accepted = max(state.accepted, event.accepted)
    context.count("journals_lost")
    over = PendingOutcome(kind=OutcomeKind.FAILED, message=f"{event.why}; {CLEARS}", stop=StopReason.SUBSYSTEM_LOST)
    for command in state.commands.values():
        command.jobs += JOBS_APART
        context.follow(command.id, Stimulus.STOP, over)


def is_lost(state: State, event: CommandReceived) -> bool:
    """Whether a request that we do not know was one of a broker before us: its client has its number, or it was sent
    before the loss."""
    return bool(event.known_as) or 0 < event.sent_at_s <= state.lost_at_s


def new_number(state: State, event: CommandReceived) -> str:
    """The number that the client knows, if that is free; else the next one."""
    name, digits = event.known_as, event.known_as.removeprefix("C-")
    number = int(digits[:18]) if digits.isascii() and digits.isdigit() else 0
    taken = name in state.commands or name in state.ended
    free = name == f"C-{number}" and 0 < number <= state.accepted + FURTHEST and not taken
    if not free:
        number = state.accepted + 1
    state.accepted = max(state.accepted, number)
    return f"C-{number}"


def end_lost(context: DecisionContext, event: CommandReceived) -> None:
    """A true outcome for who waits for it, under the number that the client knows, if that is free."""
    state = context.state
    command = Command(
        id=new_number(state, event),
        client=event.client,
        request=event.request,
        text=event.text,
        source=event.source,
        progress=event.progress,
        halt_if_lost=event.halt_if_lost,
        accepted_at_s=event.at_s,
        phase=Phase.HELD,
    )
    state.commands[command.id] = command
    state.live[event.client] = state.live.get(event.client, 0) + 1
    state.requests[request_key(event.client, event.request)] = command.id
    context.effects.append(TellClient(client=event.client, message=Accepted(request=event.request, command=command.id)))
    why = state.lost or "its outcome is no longer kept"
    end(context, command, OutcomeKind.FAILED, message=f"{why}: how far it came is not known; {CLEARS}")


def publish(context: DecisionContext) -> None:
    """Tell those who listen to the events."""
    state = context.state
    if state.lost:
        state.seq += 1
        note = ProgressNote(seq=state.seq, at_s=context.now, command="", phase=Phase.ENDED, note=state.lost)
        context.effects.append(PublishNote(client="", note=note))
