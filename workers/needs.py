"""What a script may need of the world, by registered name, and what brings it about when it is not so. Pure."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from rtc import geometry
from rtc.outcomes import Refusal, RefusalReason
from workers.belief import Belief
from workers.situation import Situation

IN_SEAT_M = 0.02  # what a hand lets go of this near to its seated place is taken to be in the seat


class Lack(NamedTuple):
    """What is not so, the thing or arm that is in the way, and the row of `needs` that clears it (else its own)."""

    message: str
    held: str
    row: str = ""
    thing: str = ""  # what would have to be let go of, if it is not `held`


def seat_of(belief: Belief, thing: str) -> str:
    """The seat in which a thing would stay when it is let go; empty when there is none."""
    at = belief.frame(thing)
    seats = (seat.name for seat in belief.cell.seats)
    return next((name for name in seats if geometry.distance(at, belief.seated_pose(name)) < IN_SEAT_M), "")


def _hand_empty(at: Situation) -> Lack | None:
    held = at.belief.holding(at.arm.name)
    return Lack(f"{at.arm.name} holds {held}", held) if held else None


def _object_free(at: Situation) -> Lack | None:
    assert at.thing is not None
    if at.thing.fixed:
        return Lack(f"{at.thing.name} is fixed", at.thing.name, "object_fixed")
    holder = at.belief.held_by(at.thing.name)
    return Lack(f"{at.thing.name} is held by {holder}", holder, thing=at.thing.name) if holder else None


def _object_held(at: Situation) -> Lack | None:
    assert at.thing is not None
    holder = at.belief.held_by(at.thing.name)
    if holder == at.arm.name:
        return None
    if holder:
        message = f"{at.thing.name} is held by {holder}, not by {at.arm.name}"
        return Lack(message, holder, "held_by_another", at.thing.name)
    return Lack(f"{at.thing.name} is not held", at.thing.name)


def _object_seated(at: Situation) -> Lack | None:
    assert at.thing is not None
    name = at.thing.name
    return None if seat_of(at.belief, name) else Lack(f"{name} is in no seat, and would drift away", name)


def _seat_free(at: Situation) -> Lack | None:
    assert at.target is not None
    inside = [t.name for t in at.belief.cell.objects if at.belief.seat(t.name) == at.target.name]
    others = [name for name in inside if at.thing is None or name != at.thing.name]
    return Lack(f"{at.target.name} holds {others[0]}", others[0]) if others else None


def _width_known(at: Situation) -> Lack | None:
    known = at.belief.trusts(f"{at.arm.name}.hand_width")
    return None if known else Lack(f"it is not known how wide the hand of {at.arm.name} is open", at.arm.name)


NEEDS: dict[str, Callable[[Situation], Lack | None]] = {
    "hand_empty": _hand_empty,
    "object_free": _object_free,
    "object_held": _object_held,
    "object_seated": _object_seated,
    "seat_free": _seat_free,
    "width_known": _width_known,
}


def lacking(need: str, at: Situation) -> Refusal | None:
    """Why the script cannot be done now; None when what it needs is so."""
    lack = NEEDS[need](at)
    if lack is None:
        return None
    rows = at.program.needs
    thing = lack.thing or lack.held
    clears = rows.get(lack.row or need, "").replace("{let_go}", _let_go(rows, at.belief, thing))
    clears = at.say(clears).replace("{held}", lack.held)
    doubt = at.belief.distrusted(f"{at.thing.name}.held_by", {}) if at.thing is not None else None
    message = lack.message + (f", but {doubt.message}" if doubt else "")
    return Refusal(reason=RefusalReason.STATE, message=message, clears=clears)


def _let_go(rows: dict[str, str], belief: Belief, thing: str) -> str:
    """The sentence that empties the hand: where it is, if the thing stays there; else by way of a free seat."""
    if thing not in {known.name for known in belief.cell.objects} or seat_of(belief, thing):
        return rows.get("let_go", "").replace("{held}", thing)
    taken = {belief.seat(known.name) for known in belief.cell.objects if known.name != thing}
    free = [seat.name for seat in belief.cell.seats if seat.name not in taken]
    row = "let_go_in_air" if free else "let_go"
    return rows.get(row, "").replace("{held}", thing).replace("{free}", " or ".join(free))
