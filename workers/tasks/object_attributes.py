"""Attributes of a candidate's object as figures, and the refusal of one that is not stated (R105). Pure."""

from __future__ import annotations

from collections.abc import Collection

from rtc.model.cells import parts
from rtc.programs import attributes
from rtc.programs.schema import ElaboratorProgram
from rtc.protocol.advice import by_person, fill_in
from rtc.protocol.causes import Distrusted
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused
from workers.planning.world_query import WorldQuery


def figures(program: ElaboratorProgram, query: WorldQuery, thing: parts.Object | None) -> dict[str, float]:
    """The attributes of the object that are stated and trusted, by figure: object.bar_width_m."""
    if thing is None:
        return {}
    keys = {figure: f"{thing.name}.{name}" for figure, name in attributes.figures(program).items()}
    values = {figure: query.world.value(key) for figure, key in keys.items() if query.trusts(key)}
    return {figure: float(value) for figure, value in values.items() if isinstance(value, int | float)}


def why_unstated(
    program: ElaboratorProgram, query: WorldQuery, thing: parts.Object | None, names: Collection[str]
) -> Refusal | None:
    """The refusal if one of these figures is an attribute that has no trusted value; None if all have one."""
    given = figures(program, query, thing) if names else {}
    missing = next((name for name in sorted(names) if name not in given), None)
    if missing is None:
        return None
    attribute = attributes.figures(program)[missing]
    word = attribute.upper().replace("_", "-")
    if thing is None:
        message = f"{missing} is an attribute of an object, and this use of the verb is without one"
        return Refusal(
            reason=RefusalReason.PROGRAM, message=message, where=missing, clears=by_person("a sentence with an object")
        )
    fact = query.world.get(f"{thing.name}.{attribute}")
    why = "is not known" if fact is None or fact.value is None else f"is {fact.validity.value}"
    texts = {"location": thing.name, "attribute": word, "key": attribute}
    example = program.settable[attribute].example
    clears = fill_in(program.clears.get("stated", []), {**texts, "example": example})
    message = f"{word} of {thing.name} {why}; the program needs it"
    key = f"{thing.name}.{attribute}"
    cause = None
    if fact is not None and fact.value is not None:
        cause = Distrusted(fact=key, validity=fact.validity.value, source=fact.source, version=fact.version)
    return Refusal(reason=RefusalReason.STATE, message=message, where=key, clears=clears, cause=cause)


def refuse_unstated(
    program: ElaboratorProgram, query: WorldQuery, thing: parts.Object | None, names: Collection[str]
) -> None:
    if (refusal := why_unstated(program, query, thing, names)) is not None:
        raise Refused(refusal)
