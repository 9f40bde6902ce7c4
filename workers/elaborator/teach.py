"""SET of what is no attribute of an object: a taught place, and all facts at once. Pure.

`SET P1 POSTURE-OF-RIGHT-ARM HERE` (or joint values, or NONE to forget it), `SET WORLD FACTS INITIAL`.
"""

from __future__ import annotations

from typing import Any

from rtc.model.cells import taught
from rtc.programs.schema import ElaboratorProgram
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.sentence import ParsedCommand
from workers.elaborator import preconditions
from workers.planning import suggestions
from workers.planning.world_query import WorldQuery

HERE, NONE, INITIAL = "HERE", "NONE", "INITIAL"
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
        clears = f"{parsed.verb} {place} {parsed.attribute} {HERE}"
        where = parsed.attribute or ""
        raise Refused.because(RefusalReason.SENTENCE, message, where=where, clears=clears)
    return {key: values}, [place]


def _arm(parsed: ParsedCommand) -> str:
    return taught.arm_of((parsed.attribute or "").lower().replace("-", "_"))


def is_world(parsed: ParsedCommand, query: WorldQuery) -> bool:
    return parsed.object == taught.WORLD and taught.WORLD not in query.cell.names()


def world(program: ElaboratorProgram, parsed: ParsedCommand, query: WorldQuery) -> Stated:
    """All facts of objects and seats as in the cell. Arms keep theirs: they are measured. Raises Refused."""
    if (parsed.attribute, parsed.value) != ("FACTS", [INITIAL]):
        message = f"of {taught.WORLD} only FACTS {INITIAL} can be set"
        clears = f"{parsed.verb} {taught.WORLD} FACTS {INITIAL}"
        raise Refused.because(RefusalReason.SENTENCE, message, clears=clears)
    for arm in query.cell.arms:
        if held := query.holding(arm.name):
            let_go = preconditions.let_go(program.needs, query, held)
            message = f"{arm.name} holds {held}; a reset of the facts would deny that, and moves nothing"
            raise Refused.because(RefusalReason.STATE, message, where=held, clears=f"first {let_go}")
    cell = query.cell
    concerned = [part.name for group in (cell.arms, cell.objects, cell.seats) for part in group]
    return {f"{taught.WORLD}.facts": INITIAL.lower()}, [taught.WORLD, *concerned]
