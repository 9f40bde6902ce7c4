"""The sentence of a record, for advice: of sentences that move a hand to a goal, or anything by an amount. Pure.

Its limits and reflexes are kept, because they protect something. REPORT and the order of commands are left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from rtc.language.hands import hand_in_words
from rtc.protocol.sentence import Constraint, Destination, ParsedCommand, Quantity, ReflexItem
from rtc.protocol.units import in_words

PATHS = {"joint": "JOINT-MOTION", "straight_line": "STRAIGHT-LINE"}


def sentence_of(parsed: ParsedCommand, amount: str = "") -> str:
    """The sentence; empty if it is of another form. `amount`: words in the place of its own amount. A target without a
    path is that of another form: its preposition is not in the record."""
    goal = _goal(parsed, amount)
    if not goal or (parsed.target and not parsed.path) or parsed.grasp_point or parsed.until or parsed.performer:
        return ""
    path = PATHS[parsed.path] if parsed.path else ""
    hand = hand_in_words(parsed.hand) if parsed.hand else ""
    words = [parsed.verb, parsed.object or hand, goal, *(f"THROUGH {name}" for name in parsed.through), path]
    if parsed.object and hand:
        words.append(f"WITH {hand}")
    return " ".join(filter(None, [*words, *_clauses(parsed)]))


def relative_amount(parsed: ParsedCommand) -> Quantity | None:
    """The amount of a relative sentence; None of others."""
    return parsed.place.by if parsed.place is not None else parsed.amount


def _goal(parsed: ParsedCommand, amount: str) -> str:
    by = relative_amount(parsed)
    if by is not None:
        along = parsed.place.along if parsed.place is not None else None
        return f"BY {amount or _quantity(by)}" + (f" ALONG {along}" if along else "")
    if parsed.place is not None:
        return _place(parsed.place)
    return f"TO {parsed.target}" if parsed.target else ""


def _place(place: Destination) -> str:
    if place.joints is not None and not place.sliding:
        return f"TO JOINTS {' '.join(f'{round(math.degrees(q), 6):g}' for q in place.joints)} DEG"
    if place.position is not None:
        return f"TO POSITION {' '.join(f'{round(100.0 * x, 6):g}' for x in place.position)} CM"
    if place.neighborhood_of or place.grasp_point_of:
        kind = "NEIGHBORHOOD" if place.neighborhood_of else "GRASP-POINT"
        return f"TO-{kind}-OF {place.neighborhood_of or place.grasp_point_of}"
    return f"TO {place.name}" if place.name else ""


def _clauses(parsed: ParsedCommand) -> Iterator[str]:
    if parsed.constraints:
        yield f"MAINTAIN {' AND '.join(map(_constraint, parsed.constraints))}"
    if parsed.guarded:
        yield "GUARDED"
    yield from map(_reflex, parsed.reflexes)


def _constraint(item: Constraint) -> str:
    value = "" if item.value is None else _quantity(item.value)
    by = "BY" if value and item.slot == "AVOID-NEIGHBORS" else ""
    return " ".join(filter(None, (item.slot, item.name, by, value)))


def _reflex(item: ReflexItem) -> str:
    action = item.action.upper().replace("_", "-")
    by = f"BY {_quantity(item.by)}" if item.by is not None else ""
    tried = f"AND TRY {item.trim}" if item.trim else ""
    return " ".join(filter(None, (f"UNLESS {item.condition.sentence} THEN {action}", by, tried)))


def _quantity(quantity: Quantity) -> str:
    words = in_words(quantity.value, quantity.unit).upper()
    return f"{words}S" if quantity.unit == "turn" and quantity.value != 1.0 else words
