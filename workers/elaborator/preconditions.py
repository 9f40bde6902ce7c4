"""Preconditions of scripts by registered name, and the advice that establishes an unmet one. Pure."""

from __future__ import annotations

from rtc.language.hands import hand_in_words
from rtc.programs.schema import ScriptFile
from rtc.protocol.advice import Texts, fill_in
from rtc.protocol.causes import AlreadyDone, NeedUnmet
from rtc.protocol.outcomes import RefusalReason, Refused
from workers.mechanisms import each, joined
from workers.planning import trust
from workers.tasks.candidate import TaskCandidate
from workers.tasks.unmet import let_go

NEEDS = joined(lambda mechanism: mechanism.needs)
DONE = each(lambda mechanism: mechanism.done)


def refuse_if_done(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse a sentence whose end is so before it begins, as that of a task that was halted while its hand backed off.

    What precedes in the script would be refused with advice that undoes the task: to take again what was put down."""
    thing = candidate.thing
    if thing is None or candidate.hand is None or not candidate.query.trusts(f"{thing.name}.held_by"):
        return
    for message, row in filter(None, (done(script, candidate) for done in DONE)):
        texts = {"hand": hand_in_words(candidate.arm.name), "place": [place.name for place in candidate.query.places]}
        clears = fill_in(candidate.program.needs.get(row, []), {**texts, **candidate.texts})
        raise Refused.because(RefusalReason.STATE, message, clears=clears, cause=AlreadyDone(object=thing.name))


def refuse_if_unmet(need: str, candidate: TaskCandidate) -> None:
    """Refuse an unmet precondition, with the sentence that establishes it."""
    lack = NEEDS[need](candidate)
    if lack is None:
        return
    rows = candidate.program.needs
    thing = lack.thing or lack.held
    row = lack.row or need
    if candidate.parsed.hand and f"{row}_by" in rows:  # with the hand of the sentence first
        row = f"{row}_by"
    texts: Texts = {"let_go": let_go(rows, candidate.query, thing), "hand": hand_in_words(candidate.arm.name)}
    clears = fill_in(rows.get(row, []), {**texts, **candidate.texts, "held": lack.held})
    doubt = (
        trust.distrusted(candidate.query, f"{candidate.thing.name}.held_by", {})
        if candidate.thing is not None
        else None
    )
    message = lack.message + (f", but {doubt.message}" if doubt else "")
    cause = NeedUnmet(need=lack.row or need, by=lack.held, doubt=doubt.where if doubt else "")
    raise Refused.because(RefusalReason.STATE, message, clears=clears, cause=cause)
