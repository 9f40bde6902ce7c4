"""SET sentences: (program, parsed command, world) -> a script that submits the stated facts to an analyzer. Pure.

This module checks only the form: the object exists, the attribute can be set, and the values have its number and unit.
The analyzer judges whether the facts are plausible, and it alone writes them. Beside attributes a sentence states
taught places (`SET P1 POSTURE-OF-RIGHT-ARM HERE`), the default strategy of a verb, and all facts at once (`SET WORLD
FACTS INITIAL` or `SAVED`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from rtc.model.cells import parts, taught
from rtc.programs.attributes import PLAIN
from rtc.programs.schema import ElaboratorProgram, SettableAttribute
from rtc.protocol.advice import by_sentence, fill_in
from rtc.protocol.messages import Script
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.sentence import ParsedCommand
from rtc.protocol.spelling import is_next_number, nearest
from rtc.spatial import geometry
from rtc.world.model import location
from workers.mechanisms.mechanism import Stated, Thing
from workers.planning import suggestions
from workers.planning.world_query import WorldQuery
from workers.tasks import command_fields
from workers.tasks.command_fields import SAVED
from workers.tasks.data_sentence import DataSentence
from workers.tasks.strategies import DEFAULT, STRATEGY, is_strategy, names
from workers.tasks.unmet import let_go, refuse_held

Concerned = tuple[dict[str, Any], list[str]]  # facts by key, and what is claimed and may be written

HERE, NONE, INITIAL, UNKNOWN = "HERE", "NONE", "INITIAL", "UNKNOWN"
ANGLES = ("roll", "pitch", "yaw")


def script(sentence: DataSentence, attributes: Mapping[str, Stated]) -> Script:
    """The script for a SET command; its context holds the stated facts. `attributes`: what makes the facts of an
    attribute; of another one its values are the fact. Raises Refused."""
    program, parsed, query = sentence.program, sentence.parsed, sentence.query
    command_fields.refuse_unused_field(parsed, sentence.file.script, sentence.file.uses)
    name = parsed.object or ""
    if taught.arm_of(_attribute(parsed)):
        return sentence.script("", name, *_posture(parsed, query))
    if name.removesuffix(STRATEGY) in program.branches:
        return sentence.script("", name, *_default(program, parsed))
    if name == taught.WORLD and taught.WORLD not in query.cell.names():
        return sentence.script("", name, *_world(sentence))
    things: dict[str, Thing] = {thing.name: thing for thing in query.cell.objects}
    things |= {seat.name: seat for seat in query.cell.seats}
    if name not in things:
        raise suggestions.unknown("object or seat", name, things)
    facts = _facts(sentence, things[name], attributes)
    inside = [*(location(key) for key in facts), *(query.inside(name) if query.is_seat(name) else [])]
    if f"{name}.frame" in facts and (holder := query.held_by(name)):
        inside.append(holder)  # the hand's `holding` and the grasp follow from the frame
    return sentence.script(_new(program, parsed), name, facts, [name, *inside])


def _new(program: ElaboratorProgram, parsed: ParsedCommand) -> str:
    """The remark about an attribute that no program declares: it may be meant for another one."""
    known = _attribute(parsed) in program.settable
    return "" if known else f"{parsed.attribute} is kept, and no program uses it"


def _attribute(parsed: ParsedCommand) -> str:
    """The attribute's name in the world: held_by for HELD-BY."""
    return (parsed.attribute or "").lower().replace("-", "_")


def _facts(sentence: DataSentence, thing: Thing, attributes: Mapping[str, Stated]) -> dict[str, Any]:
    """The stated facts by key, in SI units. The refusal of a wrong form states the correct one."""
    program, parsed, query = sentence.program, sentence.parsed, sentence.query
    attribute = _attribute(parsed)
    values: list[float | str] = parsed.value or []
    if isinstance(thing, parts.Seat) and attribute not in program.settable_of_seats:
        settable = [_word(name) for name in program.settable_of_seats]
        raise suggestions.unknown("attribute of a seat", parsed.attribute or "", settable, where=parsed.attribute or "")
    if attribute in program.not_settable:
        raise Refused.because(
            RefusalReason.NOT_ALLOWED,
            f"{parsed.attribute} of {thing.name} cannot be set; the cluster determines it",
            where=parsed.attribute or "",
            clears=fill_in(program.not_settable[attribute], {"object": thing.name}),
        )
    if attribute in program.settable:
        row = program.settable[attribute]
        if attribute == "frame" and values == [UNKNOWN]:
            return _unplaced(program, thing, query)
        if not _fits(row, parsed):
            raise _misfit(row, parsed, thing)
        if (make := attributes.get(attribute)) is not None:
            facts = make(program, values, thing, query)
            if f"{thing.name}.frame" in facts:
                _refuse_fixed(thing)
            return facts
    else:
        known = [_word(name) for name in (*program.settable, *program.not_settable, *_others(thing, query))]
        like = nearest(parsed.attribute or "", known)
        if like and parsed.attribute not in known and not is_next_number(parsed.attribute or "", like):
            raise suggestions.unknown("attribute", parsed.attribute or "", known, where=parsed.attribute or "")
    return {f"{thing.name}.{attribute}": values[0] if len(values) == 1 else values}


def _fits(row: SettableAttribute, parsed: ParsedCommand) -> bool:
    """Whether the values have the row's number and unit, or are a name, or a position with an attitude."""
    values, unit = parsed.value or [], parsed.value_unit
    if not row.unit:
        return len(values) == len(row.of) and all(isinstance(word, str) for word in values)
    turned = " ".join([row.unit] * len(row.of) + ["rad"] * len(ANGLES))
    return ((unit or PLAIN) == row.unit and len(values) == len(row.of)) or (row.attitude and unit == turned)


def _others(thing: Thing, query: WorldQuery) -> list[str]:
    """Attributes of this object or seat that have a fact."""
    own = f"{thing.name}."
    return [key.removeprefix(own) for key in query.world.facts if key.startswith(own)]


def _word(attribute: str) -> str:
    return attribute.upper().replace("_", "-")


def _misfit(row: SettableAttribute, parsed: ParsedCommand, thing: Thing) -> Refused:
    values = parsed.value or []
    what = "a name" if any(isinstance(v, str) for v in values) else f"{len(values)} number{'s' * (len(values) != 1)}"
    unit = f"in {parsed.value_unit}" if parsed.value_unit else "without a unit"
    wanted = f"{' '.join(row.of)} in {row.unit}" if row.unit else "a name"
    wanted = f"{' '.join(row.of)} without a unit" if row.unit == PLAIN else wanted
    wanted += f", and may go on with {' '.join(ANGLES)} in rad" if row.attitude else ""
    return Refused.because(
        RefusalReason.SENTENCE,
        f"{parsed.attribute} of {thing.name} is {wanted}; the sentence has {what} {unit}",
        where=parsed.attribute or "",
        expected=[row.example],
        clears=f"for example: {parsed.verb} {thing.name} {parsed.attribute} {row.example}",
    )


# --- poses -----------------------------------------------------------------------------------------------


def frame(_: ElaboratorProgram, values: list[Any], thing: Thing, query: WorldQuery) -> dict[str, Any]:
    """A position, with the stated attitude or the current one."""
    angles = values[3:]
    turned = geometry.from_rpy((0, 0, 0), angles)[3:] if angles else query.pose(thing.name)[3:]
    return _pose(values[:3], turned, thing)


def _unplaced(program: ElaboratorProgram, thing: Thing, query: WorldQuery) -> dict[str, Any]:
    """The pose is not known any more: no step relies on it until it is located or stated."""
    refuse_held(program, thing.name, query)
    _refuse_fixed(thing)
    return {f"{thing.name}.frame": None}


def attitude(_: ElaboratorProgram, values: list[Any], thing: Thing, query: WorldQuery) -> dict[str, Any]:
    """An attitude, at the current position."""
    return _pose(query.pose(thing.name)[:3], geometry.from_rpy((0, 0, 0), values)[3:], thing)


def _refuse_fixed(thing: Thing) -> None:
    if isinstance(thing, parts.Object) and thing.fixed:
        raise Refused.because(RefusalReason.STATE, f"{thing.name} is fixed", clears="another object")


def _pose(place: Any, turned: Any, thing: Thing) -> dict[str, Any]:
    return {f"{thing.name}.frame": [float(n) for n in (*place, *turned)]}


# --- what is no attribute of an object -------------------------------------------------------------------


def _posture(parsed: ParsedCommand, query: WorldQuery) -> Concerned:
    """The posture of an arm at a place that has a name of its own. Raises Refused."""
    place, name, where = parsed.object or "", taught.arm_of(_attribute(parsed)), parsed.attribute or ""
    arms = {arm.name: arm for arm in query.cell.arms}
    if name not in arms:
        raise suggestions.unknown("arm", name, arms, where=where)
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
        raise Refused.because(RefusalReason.SENTENCE, message, where=where, clears=clears)
    return {key: values}, [place]


def _default(program: ElaboratorProgram, parsed: ParsedCommand) -> Concerned:
    """The default strategy of a verb; NONE forgets it. Raises Refused."""
    place = parsed.object or ""
    verb = place.removesuffix(STRATEGY)
    rows = program.branches[verb]
    values = parsed.value or []
    name = values[0] if len(values) == 1 and isinstance(values[0], str) else ""
    if parsed.attribute != DEFAULT or not name:
        message = f"of {place} only {DEFAULT} can be set, to the name of a strategy or to {NONE}"
        clears = by_sentence(f"{parsed.verb} {place} {DEFAULT} {[*names(rows), NONE][0]}", instead=True)
        raise Refused.because(RefusalReason.SENTENCE, message, where=parsed.attribute or "", clears=clears)
    if name != NONE and not any(is_strategy(name, verb, row.script) for row in rows):
        raise suggestions.unknown(f"{verb} strategy", name, [*names(rows), NONE])
    return {f"{place}.{DEFAULT.lower()}": None if name == NONE else name}, [place]


def _world(sentence: DataSentence) -> Concerned:
    """All facts of objects and seats as in the cell, or as in a file. Arms keep theirs: they are measured. Raises
    Refused."""
    parsed, query = sentence.parsed, sentence.query
    if (parsed.attribute, parsed.value) not in (("FACTS", [INITIAL]), ("FACTS", [SAVED])):
        message = f"of {taught.WORLD} only FACTS {INITIAL} or FACTS {SAVED} can be set"
        clears = by_sentence(f"{parsed.verb} {taught.WORLD} FACTS {INITIAL}", instead=True)
        raise Refused.because(RefusalReason.SENTENCE, message, clears=clears)
    for arm in query.cell.arms:
        if held := query.holding(arm.name):
            empties = let_go(sentence.program.needs, query, held)
            message = f"{arm.name} holds {held}; other facts would deny that, and move nothing"
            raise Refused.because(RefusalReason.STATE, message, where=held, clears=empties)
    cell = query.cell
    concerned = [part.name for group in (cell.arms, cell.objects, cell.seats) for part in group]
    if parsed.value == [INITIAL]:
        return {f"{taught.WORLD}.facts": INITIAL.lower()}, [taught.WORLD, *concerned]
    facts = _of_file(sentence)
    places = dict.fromkeys(location(key) for key in facts if taught.arm_of(key.rpartition(".")[2]))
    return {f"{taught.WORLD}.facts": {SAVED.lower(): facts}}, [taught.WORLD, *concerned, *places]


def _of_file(sentence: DataSentence) -> dict[str, Any]:
    """The facts of a file about objects, seats and taught places, as plain data. Raises Refused."""
    query, saved = sentence.query, sentence.saved
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
