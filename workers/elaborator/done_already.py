"""A sentence whose end is so before it begins, as that of a task that was halted while its hand backed off. Pure.

What precedes in the script would be refused with advice that undoes the task: to take again what was put down.
"""

from __future__ import annotations

from rtc.language.hands import hand_in_words
from rtc.programs.schema import ScriptFile
from rtc.protocol import causes
from rtc.protocol.advice import fill_in
from rtc.protocol.outcomes import RefusalReason, Refused
from workers.tasks.candidate import TaskCandidate

LET_GO = "let_go"  # effect of a step, and row of `needs` that says what is left to do
TAKEN_OUT = "object_in_target"  # precondition of a script that takes an object out of its seat


def refuse(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse a sentence whose object is where it should be, with the sentence that frees the arm."""
    thing = candidate.thing
    if thing is None or candidate.hand is None or not candidate.query.trusts(f"{thing.name}.held_by"):
        return
    if any(step.words.get("effect") == LET_GO for step in script.steps):
        message, row = _let_go(candidate), "let_go_already"
    elif TAKEN_OUT in script.needs:
        message, row = _taken_out(candidate), "taken_out_already"
    else:
        return
    if not message:
        return
    texts = {"hand": hand_in_words(candidate.arm.name), "place": [place.name for place in candidate.query.places]}
    clears = fill_in(candidate.program.needs.get(row, []), {**texts, **candidate.texts})
    raise Refused.because(RefusalReason.STATE, message, clears=clears, cause=causes.AlreadyDone(object=thing.name))


def _let_go(candidate: TaskCandidate) -> str:
    """That the object was let go of where the sentence says; empty if it was not."""
    query, thing, target = candidate.query, candidate.thing, candidate.target
    assert thing is not None
    holder, partner = query.held_by(thing.name), candidate.partner
    if partner is not None:
        return f"{partner.name} holds {thing.name} already" if holder == partner.name else ""
    if holder or query.holding(candidate.arm.name):
        return ""
    if target is None:
        return f"{thing.name} is not held"
    return f"{thing.name} is in {target.name} already, and not held" if query.seat(thing.name) == target.name else ""


def _taken_out(candidate: TaskCandidate) -> str:
    query, thing, target = candidate.query, candidate.thing, candidate.target
    assert thing is not None
    out = not (query.seat(thing.name) or query.seat_around(thing.name))
    held = query.held_by(thing.name) == candidate.arm.name
    return f"{thing.name} is out of {target.name} already" if target is not None and out and held else ""
