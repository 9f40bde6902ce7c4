"""That a motion of the hand takes along what it holds in a seat, if the sentence does not name it. Pure."""

from __future__ import annotations

import msgspec

from rtc.protocol.messages import Step
from workers.tasks.candidate import TaskCandidate


def noted(steps: list[Step], candidate: TaskCandidate) -> list[Step]:
    """The steps of a script; the first motion of a RETRACT, say, states in its result what goes with the hand."""
    query = candidate.query
    held = query.holding(candidate.arm.name) if candidate.hand is not None and candidate.thing is None else ""
    seat = (query.seat(held) or query.seat_around(held)) if held else ""
    moving = next((n for n, step in enumerate(steps) if step.to), None)
    if not seat or moving is None:
        return steps
    says = f"{held}, which is in {seat}, goes with the hand"
    words = msgspec.structs.replace(steps[moving].words, says="; ".join(filter(None, (steps[moving].words.says, says))))
    return [*steps[:moving], msgspec.structs.replace(steps[moving], words=words), *steps[moving + 1 :]]
