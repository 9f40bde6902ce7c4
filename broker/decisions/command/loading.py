"""LOAD name INTO kind: the broker itself loads a part of the delivered programs, as a job without a worker. Pure.

The roll-out of the program is that of any load (`broker.decisions.program_rollout`).
"""

from __future__ import annotations

from broker.decisions.command.termination import refuse
from broker.decisions.context import DecisionContext
from broker.decisions.state import NIL, Command, JobKind, ParsedHead, PendingJob
from rtc.protocol.advice import by_sentence
from rtc.protocol.messages import NoteKind, Phase, WorkerKind
from rtc.protocol.outcomes import Refusal, RefusalReason

LOAD = "LOAD"


def load(context: DecisionContext, command: Command, head: ParsedHead) -> None:
    """Load the part; refuse a kind of worker that does not exist."""
    kinds = [kind.value.upper() for kind in WorkerKind]
    if head.target not in kinds:
        message = f"there is no program of {head.target}; there are those of {', '.join(kinds)}"
        clears = by_sentence(f"{LOAD} {head.object} INTO {WorkerKind.ELABORATOR.value.upper()}", instead=True)
        refuse(context, command, Refusal(reason=RefusalReason.NAME, message=message, expected=kinds, clears=clears))
        return
    command.jobs += 1
    command.job = PendingJob(
        id=f"{command.id}/{command.jobs}",
        attempt=1,
        worker=WorkerKind(str(head.target).lower()),
        kind=JobKind.LOAD,
        about=head.object or "",
        program="",
        input=NIL,
        since_s=context.now,
    )
    context.dispatch(command.job, command.client)
    context.enter(command, Phase.ELABORATING, NoteKind.LOADING, about=head.object or "")
