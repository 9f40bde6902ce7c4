"""The sentence of a record, for advice: of sentences with a goal or an amount, or about an object alone. Pure.

Its limits and reflexes are kept, because they protect something. REPORT and the order of commands are left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import msgspec

from rtc.language.hands import hand_in_words
from rtc.language.parse import default_grammar, parse
from rtc.protocol.sentence import OPERATOR, Constraint, Destination, ParsedCommand, Quantity, ReflexItem
from rtc.protocol.units import in_words

PATHS = {"joint": "JOINT-MOTION", "straight_line": "STRAIGHT-LINE"}


def sentence_of(parsed: ParsedCommand, amount: str = "") -> str:
    """The sentence; empty if it is of another form. `amount`: words in the place of its own amount."""
    if parsed.until or parsed.performer not in (None, OPERATOR) or parsed.to_hand:
        return ""
    if goal := _goal(parsed, amount):
        return "" if parsed.grasp_point or parsed.target else _written(parsed, goal)
    return next((text for goal in _names(parsed) if _means(text := _written(parsed, goal), parsed)), "")


def _written(parsed: ParsedCommand, goal: str) -> str:
    path = PATHS[parsed.path] if parsed.path else ""
    hand = hand_in_words(parsed.hand) if parsed.hand else ""
    words = [parsed.verb, parsed.object or hand, goal, *(f"THROUGH {name}" for name in parsed.through), path]
    if parsed.object and hand:
        words.append(f"WITH {hand}")
    via = f"VIA {OPERATOR}-INTERVENTION" if parsed.performer else ""
    return " ".join(filter(None, [*words, *_clauses(parsed), via]))


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
    return ""


def _names(parsed: ParsedCommand) -> list[str]:
    """Words in which a sentence may name its target or grasp point: the preposition is not in the record."""
    if parsed.target and parsed.grasp_point:
        return []
    if parsed.target:
        return [f"{word} {parsed.target}" for word in ("TO", "ON", "INTO", "FROM", "AT")]
    return [parsed.grasp_point, f"AT {parsed.grasp_point}"] if parsed.grasp_point else [""]


def _means(sentence: str, parsed: ParsedCommand) -> bool:
    """Whether the sentence has this record."""
    asked = msgspec.structs.replace(parsed, report=None, after=None, together_with=None, now=False, test=False)
    return parse(default_grammar(), sentence) == msgspec.structs.replace(asked, assuming=None)


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
