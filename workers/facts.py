"""What a report says of a thing that nobody touched: told by somebody, or seen. Judged, then made into changes. Pure.

What cannot be true is refused, and nothing of it is believed; what can be is believed as it was said, with what follows
from it: a thing that is where a seat holds one sits in that seat, and one that is in no hand has no grasp.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from rtc import geometry
from rtc.messages import WorldChange
from rtc.outcomes import Refusal, RefusalReason
from rtc.world.model import problem
from rtc.world.spread import even
from workers.belief import Belief

Changes = list[WorldChange]
Values = Mapping[str, float]


def believed(facts: Mapping[str, Any], belief: Belief, values: Values) -> Changes | Refusal:
    """All of the facts, or why one of them cannot be."""
    changes: Changes = []
    for key, value in facts.items():
        thing, _, attribute = key.rpartition(".")
        change = WorldChange(key=key, value=value, spread=TOLD[attribute](values) if attribute in TOLD else None)
        wrong = problem(change) or PLAUSIBLE.get(attribute, _anything)(key, value, values)
        if wrong:
            return _refused(wrong, key, "say it again as it is, in the unit that is meant")
        following = FOLLOWS[attribute](thing, value, belief, values) if attribute in FOLLOWS else []
        if isinstance(following, Refusal):
            return following
        changes += [change, *following]
    return changes


def _refused(message: str, where: str, clears: str) -> Refusal:
    return Refusal(reason=RefusalReason.INFEASIBLE, message=message, where=where, clears=clears)


# --- what can be true ----------------------------------------------------------------------------------------


def _anything(key: str, value: Any, values: Values) -> str:
    return ""


def _near(key: str, value: Any, values: Values) -> str:
    away_m, most_m = math.hypot(*value[:3]), values["reach_m"]
    return f"{key} would be {away_m:.3g} m away; nothing of this cell is more than {most_m:g} m" * (away_m > most_m)


def _heavy(key: str, value: Any, values: Values) -> str:
    return "" if value > 0 else f"{key} must be more than 0 kg"


PLAUSIBLE: dict[str, Callable[[str, Any, Values], str]] = {"frame": _near, "mass": _heavy}


# --- how well it is known ------------------------------------------------------------------------------------


TOLD: dict[str, Callable[[Values], list[float]]] = {"frame": lambda values: even(values["told_m"], values["told_rad"])}


# --- what follows --------------------------------------------------------------------------------------------


def _placed(thing: str, frame: Any, belief: Belief, values: Values) -> Changes | Refusal:
    """In the seat that is there, if one is; and in no hand, unless one holds it."""
    if belief.held_by(thing):
        return []
    seat = seat_at(frame, belief, values["seated_m"])
    inside = [t.name for t in belief.cell.objects if seat and t.name != thing and belief.seat(t.name) == seat]
    if inside:
        return _refused(
            f"{thing}.frame is in {seat}, where {inside[0]} is believed to be",
            f"{thing}.frame",
            f"tell first where {inside[0]} is",
        )
    return [
        WorldChange(key=f"{thing}.seat", value=seat),
        WorldChange(key=f"{thing}.grasp", value=None),
    ]


def seat_at(frame: Any, belief: Belief, within_m: float) -> str:
    """The seat whose module would be here; empty when none is near enough."""
    away_m = {seat.name: geometry.distance(frame, belief.cell.seated_pose(seat.name)) for seat in belief.cell.seats}
    near = [name for name, distance_m in away_m.items() if distance_m <= within_m]
    return min(near, key=lambda name: away_m[name], default="")


FOLLOWS: dict[str, Callable[[str, Any, Belief, Values], Changes | Refusal]] = {"frame": _placed}
