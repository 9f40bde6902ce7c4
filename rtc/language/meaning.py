"""Semantic actions of the grammar: one small function per meaning, from the parts of a production to record fields.

The grammar names these functions (`-> word`); it may name only those in the table `MEANING` at the end. They do not
know the positions of words. Most clauses return a dict of record fields, and the enclosing clause merges them. Checks
that a grammar cannot express are here (repeated items) and in `quantities`. A fault raises `SentenceError` at its
column.

The grammar is right-recursive, so lists are built last item first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from lark.lexer import Token

from rtc.language.hands import ARM_OF_WORD
from rtc.language.quantities import (
    AMOUNTS,
    ANYTHING,
    CONSTRAINTS,
    JOINTS,
    LENGTH,
    MEASURES,
    PERIOD,
    STEP,
    TIME,
    check_angles,
    checked,
    in_one_unit,
    in_si,
    positions,
    si_numbers,
)
from rtc.language.refuse import SentenceError, quoted
from rtc.language.words import WrittenNumber, measured
from rtc.protocol.sentence import Condition, Constraint, Destination, ReflexItem, Report
from rtc.protocol.units import UNITS

Fields = dict[str, Any]
Parts = list[Any]

NOTHING: Fields = {}  # the fields of every empty clause; never modified

ACTIONS = {"STOP": "stop", "BACK-OFF": "back_off", "COMPLY": "comply", "RELEASE": "release"}
SHARED_PARTS = {"ORIENTATION": "WRIST"}  # synonyms for a part of a shared motion
POSITION_NUMBERS = 3  # x y z
ONCE_PER_NAME = {"AVOID-TASK-REGION"}  # constraints that may be given for several names


class HandFields(dict[str, Any]):
    """Fields of a hand, with their column: two hands of one sentence can contradict each other."""

    column: int = 0


# --- what many clauses share --------------------------------------------------------------------------


def nil(_: Parts) -> Fields:
    return NOTHING


def same(parts: Parts) -> Any:
    return parts[0]


def no_items(_: Parts) -> Parts:
    return []


def items(parts: Parts) -> Parts:
    """`item list` and `AND item list`."""
    rest: Parts = parts[-1]
    rest.append(parts[-2])
    return rest


def merge(parts: Iterable[Any]) -> Fields:
    """The fields of all parts; reserved words carry none."""
    fields: Fields = {}
    for part in parts:
        if isinstance(part, dict):
            fields.update(part)
    return fields


def command(parts: Parts) -> Fields:
    """A verb and its clauses. The first plain name is the object, the second the target."""
    verb = parts[0].value
    fields: Fields = {"verb": verb}
    for part in parts:
        if isinstance(part, dict):
            if "hand" in fields and part.__class__ is HandFields and part["hand"] != fields["hand"]:
                message = f"{fields['hand']} is named first, then {part['hand']}: {verb} takes one of them."
                raise SentenceError(part.column, message, [fields["hand"]])
            fields.update(part)
        elif part.__class__ is str:
            fields["target" if "object" in fields else "object"] = part
    for name, word in (("amount", "BY"), ("to_value", "TO")):
        if name in fields:
            takes = AMOUNTS.get(verb, ANYTHING) if "object" in fields else LENGTH  # a hand opens by a width
            if name == "to_value":
                takes = takes._replace(sense="any" if takes.sense == "any" else "not negative")
            fields[name] = checked(fields[name], takes, f"{verb} {word}")
    return fields


# --- hands, objects, places -----------------------------------------------------------------------------


def arm(parts: Parts) -> HandFields:
    """A hand is represented by its arm; ARM <name> by the name."""
    hand = HandFields(hand=ARM_OF_WORD.get(parts[-1], str(parts[-1])))
    hand.column = parts[0].start_pos
    return hand


def with_hand(parts: Parts) -> HandFields:
    hand: HandFields = parts[1]
    return hand


def of_object(parts: Parts) -> Fields:
    fields = merge(parts)
    fields["object"] = next(p for p in parts if p.__class__ is str)
    return fields


def at_point(parts: Parts) -> Fields:
    return {"grasp_point": parts[-1]}


def destination(parts: Parts) -> Fields:
    return {"place": parts[1]}


def neighborhood(parts: Parts) -> Fields:
    return {"place": Destination(neighborhood_of=parts[1])}


def grasp_point_place(parts: Parts) -> Fields:
    return {"place": Destination(grasp_point_of=parts[1])}


def relative_step(parts: Parts) -> Fields:
    return {"place": Destination(by=checked(parts[1], STEP, "MOVE BY"), **parts[2])}


def named_place(parts: Parts) -> Destination:
    return Destination(name=parts[0])


def joint_place(parts: Parts) -> Destination:
    joints = si_numbers(parts[1], JOINTS.units, parts[0])
    lengths = [n for n, (_, unit) in enumerate(in_one_unit(parts[1])) if unit is not None and UNITS[unit].si == "m"]
    return Destination(joints=joints, sliding=lengths)


def position_place(parts: Parts) -> Destination:
    position = positions(parts[1], parts[0])
    if len(position) != POSITION_NUMBERS:
        first_too_many = parts[1][::-1][POSITION_NUMBERS:]
        column = first_too_many[0].column if first_too_many else parts[1][0].column + len(parts[1][0].text)
        raise SentenceError(
            column, f"POSITION takes three numbers, not {len(position)}.", ["x y z such as 60 -20 35 CM"]
        )
    return Destination(position=position)


def straight_line(_: Parts) -> Fields:
    return {"path": "straight_line"}


def joint_motion(_: Parts) -> Fields:
    return {"path": "joint"}


def through(parts: Parts) -> Fields:
    rest: Fields = parts[2]
    return {**rest, "through": [parts[1], *rest.get("through", ())]}


def amount(parts: Parts) -> Fields:
    """Checked by the enclosing clause, which knows the quantity."""
    return {"amount": parts[-1]}


def to_value(parts: Parts) -> Fields:
    """Checked by the enclosing clause, like `amount`."""
    return {"to_value": parts[-1]}


def duration(parts: Parts) -> Fields:
    return {"duration_s": checked(parts[1], TIME, "FOR").value}


def handoff(parts: Parts) -> Fields:
    verb, name, _from, giver, _to, taker, *rest = parts
    if giver == taker:
        raise SentenceError(taker.column, f"A hand cannot hand {name} to itself.", ["another hand"])
    return command([verb, name, giver, {"to_hand": taker["hand"]}, *rest])


def verify(parts: Parts) -> Fields:
    verb, name, _at, thing = parts
    where = thing if "hand" in thing else {"target": thing["object"]}
    return command([verb, name, where])


# --- MAINTAIN -------------------------------------------------------------------------------------------


def maintain(parts: Parts) -> Fields:
    given: list[tuple[Token, Constraint]] = items(parts)[::-1]
    seen = set()
    for word, constraint in given:
        item = (constraint.slot, constraint.name if constraint.slot in ONCE_PER_NAME else None)
        if item in seen:
            raise SentenceError(word.start_pos or 0, f"{word.value} is repeated.", ["each constraint once"])
        seen.add(item)
    return {"constraints": sorted((c for _, c in given), key=lambda c: (c.slot, c.name or ""))}


def named_constraint(parts: Parts) -> tuple[Token, Constraint]:
    word, region = parts
    return word, Constraint(slot=word.value, name=region or None)


def shared_constraint(parts: Parts) -> tuple[Token, Constraint]:
    word, part = parts
    return word, Constraint(slot=word.value, name=SHARED_PARTS.get(part, part) if part else None)


def measured_constraint(parts: Parts) -> tuple[Token, Constraint]:
    word, value = parts
    slot = word.value
    if not value:
        return word, Constraint(slot=slot)
    return word, Constraint(slot=slot, value=checked(value["amount"], CONSTRAINTS.get(slot, ANYTHING), slot))


# --- conditions and reflexes ----------------------------------------------------------------------------


def until(parts: Parts) -> Fields:
    return {"until": parts[1]}


def guarded(parts: Parts) -> Fields:
    return {"guarded": True, "reflexes": parts[1][::-1]}


def unguarded(parts: Parts) -> Fields:
    return {"reflexes": parts[0][::-1]} if parts[0] else NOTHING


def reflex_item(parts: Parts) -> ReflexItem:
    return ReflexItem(condition=parts[1], **parts[3])


def event(parts: Parts) -> Condition:
    return Condition(event=parts[0].value)


def measured_condition(parts: Parts) -> Condition:
    measure, direction, bound, given = parts
    takes = MEASURES.get(measure.value, ANYTHING)
    if direction:
        takes = takes._replace(sense="any")  # a force along an axis has a sign; a magnitude has none
    quantity = checked(given, takes, f"{measure.value} {bound[0]}")
    return Condition(measure=measure.value, bound=bound[1], quantity=quantity, **direction)


def along(parts: Parts) -> Fields:
    return {"along": parts[1]}


def above(parts: Parts) -> tuple[str, str]:
    return parts[0].value, "above"


def below(parts: Parts) -> tuple[str, str]:
    return parts[0].value, "below"


def action(parts: Parts) -> Fields:
    word, *rest = parts
    fields = merge(rest)
    if "amount" in fields:
        fields["by"] = checked(fields.pop("amount"), LENGTH, f"{word.value} BY")
    return {**fields, "action": ACTIONS[word.value]}


def trim(parts: Parts) -> Fields:
    return {"trim": parts[2]}


# --- performer, report, order -----------------------------------------------------------------------------


def performer(parts: Parts) -> Fields:
    return {"performer": parts[1]}


def operator_agent(_: Parts) -> str:
    return "OPERATOR"


def report(parts: Parts) -> Fields:
    return {"report": Report(**report_items(parts))}


def report_items(parts: Parts) -> Fields:
    """The fields of an item and of the items after it, in their order."""
    fields: Fields = {}
    for part in parts:
        if isinstance(part, dict):
            if "every_s" in part and "every_s" in fields:
                raise SentenceError(parts[0].start_pos or 0, "EVERY is given twice.")
            lists = {name: [*fields.get(name, []), *part.get(name, [])] for name in ("items", "when")}
            fields = {**fields, **part, **lists}
    return fields


def reported(parts: Parts) -> Fields:
    return {"items": [parts[0].value if hasattr(parts[0], "value") else parts[0]]}


def reported_every(parts: Parts) -> Fields:
    period = checked(parts[1], PERIOD, "EVERY")
    return {"every_s": 1 / period.value if period.unit == "Hz" else period.value}


def reported_when(parts: Parts) -> Fields:
    return {"when": [parts[1]]}


def after(parts: Parts) -> Fields:
    return {"after": parts[1]}


def together_with(parts: Parts) -> Fields:
    return {"together_with": parts[1]}


def now(_: Parts) -> Fields:
    return {"now": True}


# --- control, data, operator ------------------------------------------------------------------------------


def everything(_: Parts) -> Fields:
    return {"object": "ALL"}


def set_value(parts: Parts) -> Fields:
    verb, name, attribute, datum = parts
    if attribute in ("ATTITUDE", "ORIENTATION") and isinstance(datum, Datum):
        check_angles(datum.numbers, f"SET {attribute}")
    return {"verb": verb.value, "object": name, "attribute": attribute, **datum}


def name_datum(parts: Parts) -> Fields:
    return {"value": [parts[0]]}


class Datum(dict[str, Any]):
    """Fields of stated numbers, with the numbers as written: what they mean depends on the attribute."""

    numbers: tuple[tuple[WrittenNumber, str | None], ...] = ()


def number_datum(parts: Parts) -> Fields:
    """Numbers of one dimension; or a position with an attitude (`80 77 60 CM 0 0 4 DEG`), the only mixture allowed."""
    given = in_one_unit([*parts[1], parts[0]])
    first, unit = given[0]
    si = None if unit is None else UNITS[unit].si
    kinds = (si, "rad") if si == "m" else (si,) if si else ()
    values = in_si(given, kinds, f"SET after {quoted(first.text)}")
    units = [si if unit is None else UNITS[unit].si for _, unit in given]
    if si == "m":
        check_angles(given, "the attitude")
    datum = Datum(value=values, value_unit=si if len(set(units)) == 1 else " ".join(map(str, units)))
    datum.numbers = tuple(given)
    return datum


def cannot(parts: Parts) -> Fields:
    reason = parts[1].value[1:-1]
    if not reason.strip():
        raise SentenceError(parts[1].start_pos, "The reason is empty.", ['CANNOT "the bolt is stuck"'])
    return {"verb": parts[0].value, "reason": reason}


def task_sentence(parts: Parts) -> Fields:
    return {**merge(parts), "kind": "task"}


def control_sentence(parts: Parts) -> Fields:
    return {**merge(parts), "kind": "control"}


def data_sentence(parts: Parts) -> Fields:
    return {**parts[0], "kind": "data"}


def operator_sentence(parts: Parts) -> Fields:
    return {**parts[0], "kind": "operator"}


def test_sentence(parts: Parts) -> Fields:
    return {**parts[1], **parts[2], "test": True}


def assuming(parts: Parts) -> Fields:
    return {"assuming": parts[1]}


def fault(parts: Parts) -> str:
    """The word of a stop reason, of which some are words of other clauses too."""
    (word,) = parts
    return str(word.event if isinstance(word, Condition) else getattr(word, "value", word))


def name(word: Token) -> str:
    """A name as a plain string, because the record is kept longer than the token."""
    return str(word.value)


_MEANINGS: tuple[Callable[[Parts], Any], ...] = (
    nil, same, no_items, items, merge, command, arm, with_hand, of_object, at_point, destination, neighborhood,
    grasp_point_place, relative_step, named_place, joint_place, position_place, straight_line, joint_motion, through,
    amount, to_value, duration, handoff,
    verify, maintain, named_constraint, shared_constraint, measured_constraint, until,
    guarded, unguarded, reflex_item, event, measured_condition, along, above, below, action, trim, performer,
    operator_agent, report, report_items, reported, reported_every, reported_when, after, together_with, now,
    everything, set_value, name_datum,
    number_datum, cannot, task_sentence, control_sentence, data_sentence, operator_sentence, test_sentence,
    assuming, fault,
)  # fmt: skip

#: The functions that a grammar may name: one per meaning, and a reader for each token class except STRING.
MEANING: dict[str, Callable[[Any], Any]] = {
    **{function.__name__: function for function in _MEANINGS},
    "NAME": name,
    "NUMBER": measured,
    "QUANTITY": measured,
}
