"""SET of what is no attribute of an object: a taught place, and all facts at once. Pure.

`SET P1 POSTURE-OF-RIGHT-ARM HERE` (or joint values, or NONE to forget it), `SET WORLD FACTS INITIAL` or `SAVED`.
"""

from __future__ import annotations

from typing import Any

import msgspec

from rtc.model.cells import taught
from rtc.programs.schema import ElaboratorProgram
from rtc.protocol.advice import by_sentence
from rtc.protocol.messages import SavedWorld
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.sentence import ParsedCommand
from rtc.world.model import location
from workers.planning import suggestions
from workers.planning.world_query import WorldQuery
from workers.tasks.unmet import let_go

HERE, NONE, INITIAL, SAVED = "HERE", "NONE", "INITIAL", "SAVED"
Stated = tuple[dict[str, Any], list[str]]  # facts by key, and what is claimed and may be written


def is_posture(parsed: ParsedCommand) -> bool:
    return bool(_arm(parsed))


def posture(parsed: ParsedCommand, query: WorldQuery) -> Stated:
    """The posture of an arm at a place that has a name of its own. Raises Refused."""
    place, name, arms = parsed.object or "", _arm(parsed), {arm.name: arm for arm in query.cell.arms}
    if name not in arms:
        raise suggestions.unknown("arm", name, arms, where=parsed.attribute or "")
    if what := taught.taken(query.cell, place):
        message = f"{place} is {what}; a taught place needs a name of its own"
        raise Refused.because(RefusalReason.NAME, message, where=place, clears="choose another name")
    key, values, arm = taught.key_of(place, name), parsed.value or [], arms[name]
    if values == [HERE]:
        return {key: {"now": f"{name}.joints"}}, [place, name]
    if values == [NONE]:
        if query.world.value(key) is None:
            known = [one.name for one in query.taught_places if name in one.joints_deg]
            raise suggestions.unknown(f"taught place of {name} with the name", place, known)
        return {key: None}, [place]
    slides = any(isinstance(value, str) for value in arm.home_deg)
    if len(values) != len(arm.joints) or parsed.value_unit != "rad" or slides:
        wanted = "HERE or NONE" if slides else f"HERE, NONE, or {len(arm.joints)} angles in DEG"
        message = f"the posture of {name} is {wanted}"
        clears = by_sentence(f"{parsed.verb} {place} {parsed.attribute} {HERE}", instead=True)
        where = parsed.attribute or ""
        raise Refused.because(RefusalReason.SENTENCE, message, where=where, clears=clears)
    return {key: values}, [place]


def _arm(parsed: ParsedCommand) -> str:
    return taught.arm_of((parsed.attribute or "").lower().replace("-", "_"))


def is_world(parsed: ParsedCommand, query: WorldQuery) -> bool:
    return parsed.object == taught.WORLD and taught.WORLD not in query.cell.names()


def refuse_saved(parsed: ParsedCommand) -> None:
    """Refuse facts of a file that came with a sentence which does not use them."""
    if (parsed.object, parsed.attribute, parsed.value) != (taught.WORLD, "FACTS", [SAVED]):
        message = f"facts of a file came with the sentence, which does not state that {taught.WORLD} FACTS are {SAVED}"
        raise Refused.because(RefusalReason.SENTENCE, message, clears="the sentence without them; or rtc world restore")


def world(
    program: ElaboratorProgram, parsed: ParsedCommand, query: WorldQuery, saved: SavedWorld | None = None
) -> Stated:
    """All facts of objects and seats as in the cell, or as in a file. Arms keep theirs: they are measured. Raises
    Refused."""
    if (parsed.attribute, parsed.value) not in (("FACTS", [INITIAL]), ("FACTS", [SAVED])):
        message = f"of {taught.WORLD} only FACTS {INITIAL} or FACTS {SAVED} can be set"
        clears = by_sentence(f"{parsed.verb} {taught.WORLD} FACTS {INITIAL}", instead=True)
        raise Refused.because(RefusalReason.SENTENCE, message, clears=clears)
    for arm in query.cell.arms:
        if held := query.holding(arm.name):
            empties = let_go(program.needs, query, held)
            message = f"{arm.name} holds {held}; other facts would deny that, and move nothing"
            raise Refused.because(RefusalReason.STATE, message, where=held, clears=empties)
    cell = query.cell
    concerned = [part.name for group in (cell.arms, cell.objects, cell.seats) for part in group]
    if parsed.value == [INITIAL]:
        return {f"{taught.WORLD}.facts": INITIAL.lower()}, [taught.WORLD, *concerned]
    facts = _of_file(query, saved)
    places = dict.fromkeys(location(key) for key in facts if taught.arm_of(key.rpartition(".")[2]))
    return {f"{taught.WORLD}.facts": {SAVED.lower(): facts}}, [taught.WORLD, *concerned, *places]


def _of_file(query: WorldQuery, saved: SavedWorld | None) -> dict[str, Any]:
    """The facts of a file about objects, seats and taught places, as plain data. Raises Refused."""
    if saved is None:
        message = f"{SAVED} stands for the facts of a file, and none came with the sentence"
        raise Refused.because(RefusalReason.SENTENCE, message, where=SAVED, clears="rtc world restore FILE")
    if saved.cell != query.cell.digest():
        message = "the facts are about another cell, or another version of it"
        raise Refused.because(RefusalReason.STATE, message, clears="facts that were saved with this cell")
    arms = {arm.name for arm in query.cell.arms}
    known = {part.name for group in (query.cell.objects, query.cell.seats) for part in group}
    facts = {key: fact for key, fact in saved.facts.items() if location(key) not in (*arms, taught.WORLD)}
    for key in facts:
        if location(key) not in known and not taught.arm_of(key.rpartition(".")[2]):
            raise suggestions.unknown("object or seat", location(key), known, where=key)
    plain: dict[str, Any] = msgspec.to_builtins(facts)
    return plain
