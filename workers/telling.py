"""A sentence that tells something of a thing: (program, sentence, world) -> the script that brings it to an analyzer.

Nobody moves for it, so no arm is meant and nothing is planned. Here is only seen to it that the words fit: a thing that
exists, an attribute that can be told, as many numbers as it has, in its unit. Whether what they say can be true is for
the analyzer to judge, and nothing is written here. Pure.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rtc import cell as cells
from rtc import geometry
from rtc.geometry import Array
from rtc.language.record import ParsedCommand
from rtc.messages import Script, ScriptContext, Step
from rtc.outcomes import Refusal, RefusalReason
from rtc.program_schema import ElaboratorProgram, ScriptFile, Tellable
from workers import naming, sentence
from workers.belief import WorldQuery

Thing = cells.Object | cells.Seat


def script(program: ElaboratorProgram, file: ScriptFile, parsed: ParsedCommand, query: WorldQuery) -> Script | Refusal:
    """The script, with what is told in its context."""
    misplaced = sentence.refuse_unused_field(parsed, file.script, file.uses)
    if misplaced is not None:
        return misplaced
    things: dict[str, Thing] = {thing.name: thing for thing in query.cell.objects}
    things |= {seat.name: seat for seat in query.cell.seats}
    thing = things.get(parsed.object or "")
    if thing is None:
        return naming.unknown("object or seat", parsed.object or "", things)
    facts = _facts(program, parsed, thing, query)
    if isinstance(facts, Refusal):
        return facts
    texts = {
        "object": thing.name,
        "attribute": parsed.attribute or "",
        "value": _shown(parsed),
    }
    inside = [key.rpartition(".")[0] for key in facts]
    inside += _seated(thing.name, query) if isinstance(thing, cells.Seat) else []
    if f"{thing.name}.frame" in facts and (holder := query.held_by(thing.name)):
        inside.append(holder)  # what its hand holds, and how, follows from it
    return Script(
        context=ScriptContext(
            verb=parsed.verb,
            script=file.script,
            object=thing.name,
            told=facts,
        ),
        case=file.case,
        steps=[Step(do=step.do, label=_fill_in(step.label, texts), expect=step.expect) for step in file.steps],
        resources=_names(file.resources, [thing.name, *inside]),
        writes=_names(file.writes, [thing.name, *inside]),
        candidates=[f"{file.script} {thing.name}"],
    )


def _shown(parsed: ParsedCommand) -> str:
    """The values with their units, each unit once for the numbers that share it: 0.8 0.77 0.6 m 0 0 0.07 rad."""
    said = [value if isinstance(value, str) else f"{value:.6g}" for value in parsed.value or []]
    unit = parsed.value_unit or ""
    if " " not in unit:
        return f"{' '.join(said)} {unit}".strip()
    units = unit.split()
    ends = [unit if unit != after else "" for unit, after in zip(units, [*units[1:], ""], strict=True)]
    return " ".join(word for pair in zip(said, ends, strict=True) for word in pair if word)


def _names(roles: list[str], active: list[str]) -> list[str]:
    """What the roles of a script stand for."""
    return list(dict.fromkeys(name for role in roles for name in (active if role == "active_object" else [role])))


def _seated(seat: str, query: WorldQuery) -> list[str]:
    """What sits in a seat goes with it."""
    return [thing.name for thing in query.cell.objects if query.seat(thing.name) == seat]


def _fill_in(words: str, texts: dict[str, str]) -> str:
    for name, text in texts.items():
        words = words.replace("{" + name + "}", text)
    return words


def _attribute(parsed: ParsedCommand) -> str:
    """As it is called in the world: HELD-BY is held_by."""
    return (parsed.attribute or "").lower().replace("-", "_")


def _facts(
    program: ElaboratorProgram, parsed: ParsedCommand, thing: Thing, query: WorldQuery
) -> dict[str, Any] | Refusal:
    """What is to be believed, in SI, by key; or the refusal that says how it is told."""
    attribute = _attribute(parsed)
    said: list[float | str] = parsed.value or []
    if isinstance(thing, cells.Seat) and attribute not in program.told_of_seats:
        told = [_word(name) for name in program.told_of_seats]
        return naming.unknown("attribute of a seat", parsed.attribute or "", told, where=parsed.attribute or "")
    if attribute in program.not_told:
        return Refusal(
            reason=RefusalReason.NOT_ALLOWED,
            message=f"{parsed.attribute} of {thing.name} is not told, it is found out",
            where=parsed.attribute or "",
            clears=program.not_told[attribute].replace("{object}", thing.name),
        )
    if attribute in program.told:
        row = program.told[attribute]
        if not _fits(row, parsed):
            return _misfit(row, parsed, thing)
        make = FACTS.get(attribute)
        if make is not None:
            return make(program, said, thing, query)
    else:
        known = [_word(name) for name in (*program.told, *program.not_told, *_others(thing, query))]
        like = naming.nearest(parsed.attribute or "", known)
        if like and parsed.attribute not in known:
            return naming.unknown("attribute", parsed.attribute or "", known, where=parsed.attribute or "")
    return {f"{thing.name}.{attribute}": said[0] if len(said) == 1 else said}


def _fits(row: Tellable, parsed: ParsedCommand) -> bool:
    """As many numbers as the row has, in its unit; or a name; or both a place and an attitude."""
    said, unit = parsed.value or [], parsed.value_unit
    if not row.unit:
        return len(said) == len(row.of) and all(isinstance(word, str) for word in said)
    turned = " ".join([row.unit] * len(row.of) + ["rad"] * len(ANGLES))
    return (unit == row.unit and len(said) == len(row.of)) or (row.attitude and unit == turned)


def _others(thing: Thing, query: WorldQuery) -> list[str]:
    """What else is believed of it by now, because it was told before."""
    own = f"{thing.name}."
    return [key.removeprefix(own) for key in query.world.facts if key.startswith(own)]


def _word(attribute: str) -> str:
    return attribute.upper().replace("_", "-")


def _misfit(row: Tellable, parsed: ParsedCommand, thing: Thing) -> Refusal:
    said = parsed.value or []
    what = "a name" if any(isinstance(v, str) for v in said) else f"{len(said)} number{'s' * (len(said) != 1)}"
    unit = f"in {parsed.value_unit}" if parsed.value_unit else "without a unit"
    wanted = f"{' '.join(row.of)} in {row.unit}" if row.unit else "a name"
    wanted += f", and may go on with {' '.join(ANGLES)} in rad" if row.attitude else ""
    return Refusal(
        reason=RefusalReason.SENTENCE,
        message=f"{parsed.attribute} of {thing.name} is {wanted}; said was {what} {unit}",
        where=parsed.attribute or "",
        expected=[row.example],
        clears=f"say it as in {parsed.verb} {thing.name} {parsed.attribute} {row.example}",
    )


# --- where a thing is ----------------------------------------------------------------------------------------


def _frame(program: ElaboratorProgram, said: list[Any], thing: Thing, query: WorldQuery) -> dict[str, Any] | Refusal:
    """A place, with its attitude or with the one believed so far."""
    angles = said[3:]
    attitude = geometry.from_rpy((0, 0, 0), angles)[3:] if angles else _believed(thing, query)[3:]
    return _pose(said[:3], attitude, thing)


def _attitude(program: ElaboratorProgram, said: list[Any], thing: Thing, query: WorldQuery) -> dict[str, Any] | Refusal:
    """An attitude, at the place believed so far."""
    return _pose(_believed(thing, query)[:3], geometry.from_rpy((0, 0, 0), said)[3:], thing)


def _seat(program: ElaboratorProgram, said: list[Any], thing: Thing, query: WorldQuery) -> dict[str, Any] | Refusal:
    """It is where that seat holds a thing."""
    seats = [seat.name for seat in query.cell.seats]
    if said[0] not in seats:
        return naming.unknown("seat", said[0], seats, where=said[0])
    holder = query.held_by(thing.name)
    if holder:
        message = f"{thing.name} is held by {holder}"
        clears = program.needs["object_free"].replace("{object}", thing.name)
        return Refusal(reason=RefusalReason.STATE, message=message, clears=clears)
    seated = query.seated_pose(said[0])
    return _pose(seated[:3], seated[3:], thing)


def _believed(thing: Thing, query: WorldQuery) -> Array:
    return query.seat_frame(thing.name) if isinstance(thing, cells.Seat) else query.frame(thing.name)


def _pose(place: Any, attitude: Any, thing: Thing) -> dict[str, Any] | Refusal:
    if isinstance(thing, cells.Object) and thing.fixed:
        return Refusal(reason=RefusalReason.STATE, message=f"{thing.name} is fixed", clears="another object")
    return {f"{thing.name}.frame": [float(n) for n in (*place, *attitude)]}


ANGLES = ("roll", "pitch", "yaw")
FACTS: dict[str, Callable[[ElaboratorProgram, list[Any], Thing, WorldQuery], dict[str, Any] | Refusal]] = {
    "frame": _frame,
    "attitude": _attitude,
    "seat": _seat,
}
