"""What facts from outside may say, whichever way they come: SET of one, or all of a file. Pure.

The facts are judged together, as the world would be after them: postures that an arm does not have, seats that do not
exist, a spread that says nothing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import msgspec

from rtc.model.cells import parts, taught
from rtc.protocol.messages import Validity, WorldChange
from rtc.protocol.outcomes import RefusalReason, Refused, refuse_if
from rtc.protocol.primitive.limits import HEAVIEST_KG
from rtc.spatial import geometry
from rtc.world.model import initial_facts, location, problem
from rtc.world.spread import EXACT
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import Changes

Values = Mapping[str, float]
Problems = Iterator[tuple[str, str]]  # key, problem

OF_PLACE = re.compile(r"[A-Z][A-Z0-9]*(-[A-Z0-9]+)*")
HELD: dict[str, Any] = {"held_by": "", "grasp": None}  # of an object in no hand


def near(key: str, value: Any, values: Values) -> str:
    away_m, most_m = math.hypot(*value[:3]), values["reach_m"]
    return f"{key} would be {away_m:.3g} m away; nothing of this cell is more than {most_m:g} m" * (away_m > most_m)


def heavy(key: str, value: Any, _: Values) -> str:
    return "" if value > 0 else f"{key} must be more than 0 kg"


PLAUSIBLE = {"frame": near, "mass": heavy}


def too_heavy(change: WorldChange, thing: parts.Object, _: WorldQuery) -> str:
    """Why a load cannot have this mass; empty: it can."""
    if thing.fixed or not change.key.endswith(".mass") or change.value <= HEAVIEST_KG:
        return ""
    return f"{change.key} would be {change.value:g} kg; a load has at most {HEAVIEST_KG:g} kg"


def postures(changes: Sequence[WorldChange], query: WorldQuery, __: WorldQuery, ___: Values) -> Problems:
    arms = {arm.name: len(arm.joints) for arm in query.cell.arms}
    margin_rad = math.radians(query.cell.numbers.joint_margin_deg)
    for change in changes:
        place, _, attribute = change.key.rpartition(".")
        if not attribute.startswith(taught.POSTURE):
            continue
        arm, posture = taught.arm_of(attribute), change.value
        if arm not in arms:
            yield change.key, f"{change.key} is of {arm}, and there is no such arm; there are {', '.join(arms)}"
        elif what := taught.taken(query.cell, place) or ("" if OF_PLACE.fullmatch(place) else "not a name"):
            yield change.key, f"{place!s:.40} is {what}; a taught place needs a name of its own"
        elif change.key != taught.key_of(place, arm):
            yield change.key, f"the key of this posture is {taught.key_of(place, arm)}"
        elif posture is not None and not _is_posture(posture, arms[arm]):
            yield change.key, f"{change.key} must be {arms[arm]} numbers (rad; m of a joint that slides)"
        elif posture is not None:
            refuse_if(query.model.arms[arm].why_not_within(posture, margin_rad))


def _is_posture(value: Any, joints: int) -> bool:
    return isinstance(value, list) and len(value) == joints and all(isinstance(one, int | float) for one in value)


def spreads(changes: Sequence[WorldChange], query: WorldQuery, _: WorldQuery, values: Values) -> Problems:
    for change in changes:
        if change.spread is None:
            continue
        now = query.world.get(change.key)
        if max(change.spread[:3]) > values["reach_m"] or max(change.spread[3:]) > math.pi:
            most = f"{values['reach_m']:g} m and half a turn are the most"
            yield change.key, f"the spread of {change.key} does not say where it is; {most}"
        elif not any(change.spread) and (now is None or now.spread is None or any(now.spread)):
            yield change.key, f"the spread of {change.key} is 0 about all axes; nothing is known that well"


def mounts(changes: Sequence[WorldChange], _: WorldQuery, after: WorldQuery, values: Values) -> Problems:
    """What is fixed is where the cell has it, and what is mounted on it where it has that, as far as both are known."""
    stated = {location(change.key) for change in changes if change.key.endswith(".frame")}
    every: list[parts.Seat | parts.Object] = [*after.cell.seats, *after.cell.objects]
    for part in every:
        key, on, thing = f"{part.name}.frame", part.mounted_on, part if isinstance(part, parts.Object) else None
        is_free = on is None and (thing is None or not thing.fixed or thing.unsurveyed)
        if is_free or not stated & {part.name, on} or after.world.value(key) is None or not after.trusts(key):
            continue
        known = [after.spread(key), (thing and thing.surveyed_spread) or EXACT, after.spread(f"{on}.frame")]
        thread_m = thing.thread.pitch_m * thing.thread.turns if thing and thing.thread else 0.0
        home, frame = after.mount(part), after.world.value(key)
        off_m, off_rad = geometry.distance(home, frame), geometry.angle(home, frame)
        most_m = values["seated_m"] + thread_m + sum(max(one[:3]) for one in known)
        most_rad = values["seated_rad"] + sum(max(one[3:]) for one in known)
        turns = thing is not None and (thing.hinge or thing.thread) is not None
        if off_m > most_m or (off_rad > most_rad and not turns):
            where = f"{on} has it" if on else "the cell has it"
            yield (
                key,
                f"{part.name} would be {off_m * 1000:.0f} mm and {math.degrees(off_rad):.0f} deg from where {where}",
            )


def names(changes: Sequence[WorldChange], query: WorldQuery, _: WorldQuery, __: Values) -> Problems:
    seats = {seat.name for seat in query.cell.seats}
    arms, things = {arm.name for arm in query.cell.arms}, {thing.name for thing in query.cell.objects}
    known = {"seat": ("seat", seats), "held_by": ("arm", arms), "holding": ("object", things)}
    for change in changes:
        kind, names = known.get(change.key.rpartition(".")[2], ("", set[str]()))
        if kind and change.value and not change.keep_value and change.value not in names:
            there = ", ".join(sorted(names))
            yield change.key, f"{change.key} is {change.value!s:.40}, and there is no such {kind}; there are {there}"


def hands(changes: Sequence[WorldChange], _: WorldQuery, after: WorldQuery, __: Values) -> Problems:
    """A hand is at one place: in the coupler of an arm, or where it is stated."""
    arms = [arm.name for arm in after.cell.arms if arm.hands and after.trusts(f"{arm.name}.hand")]
    in_coupler = {after.hand(arm): arm for arm in arms if after.hand(arm)}
    for change in changes:
        thing, _dot, attribute = change.key.rpartition(".")
        if thing in in_coupler and attribute in ("frame", "seat") and change.value and not change.keep_value:
            yield change.key, f"{thing} is in the coupler of {in_coupler[thing]}"


# --- all facts at once -----------------------------------------------------------------------------------


def whole(_: str, value: Any, query: WorldQuery, values: Values) -> Changes:
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
        wrong = problem(change)
        if not wrong and change.value is not None and attribute in PLAUSIBLE:
            wrong = PLAUSIBLE[attribute](key, change.value, values)
        if wrong:
            clears = "correct it in the file, or leave it out"
            raise Refused.because(RefusalReason.INFEASIBLE, str(wrong), where=key, clears=clears)
        if change.validity is Validity.CHANGING or (was_held and attribute in ("frame", "seat")):
            change = msgspec.structs.replace(change, validity=Validity.SUSPECT)
        if attribute in HELD:
            change = WorldChange(key=key, value=HELD[attribute])
        changes.append(change)
    return changes


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
