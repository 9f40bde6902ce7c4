"""Reported facts of objects that no arm touched (stated or observed): checked, then converted to world changes. Pure.

If one fact is implausible, all are refused. Plausible facts are accepted as reported, with their consequences. An
object at a seated pose is in that seat; an object that is not in a hand has no grasp.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from rtc.protocol.causes import NeedUnmet
from rtc.protocol.messages import Validity, WorldChange
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.world.model import initial_facts, location, problem
from rtc.world.spread import even
from workers.analyzer import impossible
from workers.mechanisms import each
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import Changes

Values = Mapping[str, float]


def changes_from(facts: Mapping[str, Any], query: WorldQuery, values: Values) -> Changes:
    """World changes for all facts. Raises Refused for an implausible one."""
    changes: Changes = []
    for key, value in facts.items():
        thing, _, attribute = key.rpartition(".")
        stored = next(iter(value)) if attribute == "facts" and isinstance(value, dict) else value
        change = WorldChange(key=key, value=stored, spread=SPREADS[attribute](values) if attribute in SPREADS else None)
        if attribute == "frame" and value is None:
            changes += _unplaced(thing, query)
            continue
        wrong = problem(change) or PLAUSIBLE.get(attribute, _anything)(key, value, values)
        if wrong:
            raise _refused(wrong, key, "repeat it with the correct value and unit")
        changes.append(change)
        for follows in (table[attribute] for table in FOLLOWS if attribute in table):
            changes += follows(thing, value, query, values)
    impossible.refuse(changes, query, values)
    return changes


def _refused(message: str, where: str, clears: str, cause: NeedUnmet | None = None) -> Refused:
    return Refused.because(RefusalReason.INFEASIBLE, message, where=where, clears=clears, cause=cause)


# --- plausibility ----------------------------------------------------------------------------------------


def _anything(key: str, value: Any, values: Values) -> str:
    return ""


def _near(key: str, value: Any, values: Values) -> str:
    away_m, most_m = math.hypot(*value[:3]), values["reach_m"]
    return f"{key} would be {away_m:.3g} m away; nothing of this cell is more than {most_m:g} m" * (away_m > most_m)


def _heavy(key: str, value: Any, values: Values) -> str:
    return "" if value > 0 else f"{key} must be more than 0 kg"


PLAUSIBLE: dict[str, Callable[[str, Any, Values], str]] = {"frame": _near, "mass": _heavy}


# --- uncertainty -----------------------------------------------------------------------------------------


SPREADS: dict[str, Callable[[Values], list[float]]] = {
    "frame": lambda values: even(values["stated_m"], values["stated_rad"])
}


# --- consequences ----------------------------------------------------------------------------------------


def _unplaced(thing: str, query: WorldQuery) -> Changes:
    """The pose of an object or seat is stated to be unknown: the last belief stays as a guess."""
    frame = WorldChange(key=f"{thing}.frame", keep_value=True, validity=Validity.UNKNOWN)
    if query.is_seat(thing):
        inside = query.inside(thing)
        content = [WorldChange(key=f"{name}.frame", keep_value=True, validity=Validity.SUSPECT) for name in inside]
        known = msgspec.structs.replace(frame, value=query.seat_frame(thing).tolist(), keep_value=False)
        return [known, *content]
    return [frame, WorldChange(key=f"{thing}.seat", keep_value=True, validity=Validity.UNKNOWN)]


def _whole(_: str, value: Any, query: WorldQuery, values: Values) -> Changes:
    """The facts of all objects and seats as in the cell; of those in a file ({"saved": facts by key}) as there."""
    begin = {change.key: change for change in _initial(query)}
    if isinstance(value, dict):
        begin |= {change.key: change for change in _saved(value["saved"], query, values)}
    return list(begin.values())


def _saved(facts: Mapping[str, Mapping[str, Any]], query: WorldQuery, values: Values) -> Changes:
    """The facts of a file. What was in a hand then is in none now: its place is not sure."""
    changes: Changes = []
    for key, fact in facts.items():
        change = msgspec.convert({"key": key, **fact}, WorldChange)
        thing, _, attribute = key.rpartition(".")
        was_held = bool(facts.get(f"{thing}.held_by", {}).get("value"))
        if wrong := problem(change) or (
            change.value is not None and PLAUSIBLE.get(attribute, _anything)(key, change.value, values)
        ):
            raise _refused(str(wrong), key, "correct it in the file, or leave it out")
        if change.validity is Validity.CHANGING or (was_held and attribute in ("frame", "seat")):
            change = msgspec.structs.replace(change, validity=Validity.SUSPECT)
        if attribute in HELD:
            change = WorldChange(key=key, value=HELD[attribute])
        changes.append(change)
    return changes


HELD: dict[str, Any] = {"held_by": "", "grasp": None}  # of an object in no hand


def _initial(query: WorldQuery) -> Changes:
    """The facts of all objects and seats as in the cell; those that it does not have lose their value."""
    arms, seats = ({part.name for part in group} for group in (query.cell.arms, query.cell.seats))
    begin = {change.key: change for change in initial_facts(query.cell) if location(change.key) not in arms}
    things = {thing.name for thing in query.cell.objects} | seats
    begin |= {
        key: WorldChange(key=key, value=query.cell.seat(location(key)).frame.pose.tolist())
        if key.endswith(".frame") and location(key) in seats
        else WorldChange(key=key, value=None, validity=Validity.UNKNOWN)
        for key in query.world.facts
        if location(key) in things and key not in begin
    }
    return list(begin.values())


Follows = Mapping[str, Callable[[str, Any, WorldQuery, Values], Changes]]
FOLLOWS: list[Follows] = [*each(lambda mechanism: mechanism.follows), {"facts": _whole}]
