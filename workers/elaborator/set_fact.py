"""SET commands: (program, parsed command, world) -> a script that submits the stated facts to an analyzer. Pure.

No arm moves and nothing is planned. This module checks only the form: the object exists, the attribute can be set, and
the values have its number and unit. The analyzer judges whether the facts are plausible, and it alone writes them.
"""

from __future__ import annotations

from typing import Any

from rtc.model.cells import parts
from rtc.programs.attributes import PLAIN
from rtc.programs.schema import ElaboratorProgram, ScriptFile, SettableAttribute
from rtc.protocol.advice import fill_in
from rtc.protocol.messages import SavedWorld, Script, ScriptContext, Step, StepWords
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.sentence import ParsedCommand
from rtc.protocol.spelling import nearest
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.elaborator import strategies, teach
from workers.mechanisms import joined
from workers.mechanisms.mechanism import Stated, Thing
from workers.planning import suggestions
from workers.planning.world_query import WorldQuery
from workers.tasks import command_fields
from workers.tasks.unmet import refuse_held


def script(
    program: ElaboratorProgram,
    file: ScriptFile,
    parsed: ParsedCommand,
    query: WorldQuery,
    saved: SavedWorld | None = None,
) -> Script:
    """The script for a SET command; its context holds the stated facts. `saved`: those of a file, which only SET WORLD
    FACTS SAVED states. Raises Refused."""
    command_fields.refuse_unused_field(parsed, file.script, file.uses)
    if teach.is_posture(parsed):
        return _script(file, parsed, parsed.object or "", teach.posture(parsed, query))
    if strategies.is_default(program, parsed):
        return _script(file, parsed, parsed.object or "", strategies.stated(program, parsed))
    if teach.is_world(parsed, query):
        return _script(file, parsed, parsed.object or "", teach.world(program, parsed, query, saved))
    things: dict[str, Thing] = {thing.name: thing for thing in query.cell.objects}
    things |= {seat.name: seat for seat in query.cell.seats}
    thing = things.get(parsed.object or "")
    if thing is None:
        raise suggestions.unknown("object or seat", parsed.object or "", things)
    facts = _facts(program, parsed, thing, query)
    inside = [key.rpartition(".")[0] for key in facts]
    inside += query.inside(thing.name) if isinstance(thing, parts.Seat) else []
    if f"{thing.name}.frame" in facts and (holder := query.held_by(thing.name)):
        inside.append(holder)  # the hand's `holding` and the grasp follow from the frame
    return _script(file, parsed, thing.name, (facts, [thing.name, *inside]), _new(program, parsed, thing))


def _new(program: ElaboratorProgram, parsed: ParsedCommand, thing: Thing) -> str:
    """The remark about an attribute that no program declares: it may be meant for another one."""
    if _attribute(parsed) in program.settable:
        return ""
    known = ", ".join(map(_word, program.settable))
    return f"{parsed.attribute} is kept, and no program uses it; those of {thing.name} that are used: {known}"


def _script(file: ScriptFile, parsed: ParsedCommand, name: str, stated: teach.Stated, remark: str = "") -> Script:
    """The script that states these facts. `remark`: about the success."""
    facts, concerned = stated
    texts = {
        "object": name,
        "attribute": parsed.attribute or "",
        "value": _shown(parsed),
    }
    return Script(
        context=ScriptContext(
            verb=parsed.verb,
            script=file.script,
            object=name,
            stated=facts,
        ),
        case=file.case,
        steps=[
            Step(do=step.do, label=_fill_in(step.label, texts), expect=step.expect, words=StepWords(says=remark))
            for step in file.steps
        ],
        resources=_names(file.resources, concerned),
        writes=_names(file.writes, concerned),
    )


def _shown(parsed: ParsedCommand) -> str:
    """The values with their units, each unit once for the numbers that share it: 0.8 0.77 0.6 m 0 0 0.07 rad."""
    values = [value if isinstance(value, str) else f"{value:.6g}" for value in parsed.value or []]
    unit = parsed.value_unit or ""
    if " " not in unit:
        return f"{' '.join(values)} {unit}".strip()
    units = unit.split()
    ends = [unit if unit != after else "" for unit, after in zip(units, [*units[1:], ""], strict=True)]
    return " ".join(word for pair in zip(values, ends, strict=True) for word in pair if word)


def _names(roles: list[str], active: list[str]) -> list[str]:
    """The names that the roles of a script stand for."""
    return list(dict.fromkeys(name for role in roles for name in (active if role == "active_object" else [role])))


def _fill_in(words: str, texts: dict[str, str]) -> str:
    for name, text in texts.items():
        words = words.replace("{" + name + "}", text)
    return words


def _attribute(parsed: ParsedCommand) -> str:
    """The attribute's name in the world: held_by for HELD-BY."""
    return (parsed.attribute or "").lower().replace("-", "_")


def _facts(program: ElaboratorProgram, parsed: ParsedCommand, thing: Thing, query: WorldQuery) -> dict[str, Any]:
    """The stated facts by key, in SI units. The refusal of a wrong form states the correct one."""
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
        make = FACTS.get(attribute)
        if make is not None:
            facts = make(program, values, thing, query)
            if f"{thing.name}.frame" in facts:
                _refuse_fixed(thing)
            return facts
    else:
        known = [_word(name) for name in (*program.settable, *program.not_settable, *_others(thing, query))]
        like = nearest(parsed.attribute or "", known)
        if like and parsed.attribute not in known:
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


def _frame(program: ElaboratorProgram, values: list[Any], thing: Thing, query: WorldQuery) -> dict[str, Any]:
    """A position, with the stated attitude or the current one."""
    angles = values[3:]
    attitude = geometry.from_rpy((0, 0, 0), angles)[3:] if angles else _current_pose(thing, query)[3:]
    return _pose(values[:3], attitude, thing)


def _unplaced(program: ElaboratorProgram, thing: Thing, query: WorldQuery) -> dict[str, Any]:
    """The pose is not known any more: no step relies on it until it is located or stated."""
    refuse_held(program, thing.name, query)
    _refuse_fixed(thing)
    return {f"{thing.name}.frame": None}


def _attitude(program: ElaboratorProgram, values: list[Any], thing: Thing, query: WorldQuery) -> dict[str, Any]:
    """An attitude, at the current position."""
    return _pose(_current_pose(thing, query)[:3], geometry.from_rpy((0, 0, 0), values)[3:], thing)


def _refuse_fixed(thing: Thing) -> None:
    if isinstance(thing, parts.Object) and thing.fixed:
        raise Refused.because(RefusalReason.STATE, f"{thing.name} is fixed", clears="another object")


def _current_pose(thing: Thing, query: WorldQuery) -> Array:
    return query.seat_frame(thing.name) if isinstance(thing, parts.Seat) else query.frame(thing.name)


def _pose(place: Any, attitude: Any, thing: Thing) -> dict[str, Any]:
    return {f"{thing.name}.frame": [float(n) for n in (*place, *attitude)]}


ANGLES = ("roll", "pitch", "yaw")
UNKNOWN = "UNKNOWN"
FACTS: dict[str, Stated] = {
    "frame": _frame,
    "attitude": _attitude,
    "orientation": _attitude,
    **joined(lambda mechanism: mechanism.stated),
}
