"""Which quantities a word takes, and their conversion to SI: dimension, sign and largest angle are checked.

A fault raises `SentenceError` at the column of the number.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Literal, NamedTuple

from lark.lexer import Token

from rtc.language.refuse import SentenceError, quoted
from rtc.language.words import WrittenNumber
from rtc.protocol.sentence import Quantity
from rtc.protocol.units import KINDS, LEAST, UNITS, such_as, to_si

Sense = Literal["any", "not nothing", "not negative", "more than nothing"]


class QuantityRule(NamedTuple):
    """The quantities that a word takes: SI units, the permitted sign, and the largest angle."""

    units: tuple[str, ...]
    sense: Sense = "more than nothing"
    most_deg: float = math.inf


LENGTH = QuantityRule(("m",))
TIME = QuantityRule(("s",))
ANYTHING = QuantityRule(tuple(KINDS), "any")  # for words of a grammar that is loaded later

#: verb -> quantities for BY. A negative MOVE, TURN or LIFT reverses the direction.
AMOUNTS: dict[str, QuantityRule] = {
    "RETRACT": LENGTH,
    "LIFT": QuantityRule(("m",), "not nothing"),
    "PUSH": LENGTH,
    "PULL": LENGTH,
    "OPEN": QuantityRule(("rad", "m")),  # a door, or a drawer
    "CLOSE": QuantityRule(("rad", "m")),
    "LOOSEN": QuantityRule(("turn", "rad")),
    "TIGHTEN": QuantityRule(("turn", "rad")),
    "TURN": QuantityRule(("rad", "turn"), "any"),
}

JOINTS = QuantityRule(("rad", "m"), "any")  # m: a joint of a gantry slides
PERIOD = QuantityRule(("s", "Hz"))
# MOVE ... BY: along an axis, or about it. A larger angle would be reached the other way round.
STEP = QuantityRule(("m", "rad"), "any", most_deg=180.0)
ATTITUDE = QuantityRule(("rad",), "any", most_deg=360.0)  # roll, pitch and yaw of a pose; bolts and cranks turn further

CONSTRAINTS: dict[str, QuantityRule] = {
    "AVOID-NEIGHBORS": LENGTH,
    "SPEED": QuantityRule(("m/s", "rad/s", "ratio")),
    "FORCE-LIMIT": QuantityRule(("N",)),
    "TORQUE-LIMIT": QuantityRule(("N.m",)),
    "GRIP-FORCE": QuantityRule(("N",)),
    "STIFFNESS": QuantityRule(("N/m",)),
    "TIME-LIMIT": TIME,
}

MEASURES: dict[str, QuantityRule] = {
    "FORCE": QuantityRule(("N",)),
    "TORQUE": QuantityRule(("N.m",)),
    "GRIP-FORCE": QuantityRule(("N",)),
    "DISTANCE": QuantityRule(("m",), "not negative"),
    "CLEARANCE": QuantityRule(("m",)),
    "TURN": QuantityRule(("rad", "turn")),
}

MOST_SHOWN = 12  # numbers in a message
ROUNDING_RAD = 1e-6  # 6.283185 RAD is a whole turn


def checked(given: WrittenNumber, takes: QuantityRule, by: str) -> Quantity:
    """The quantity in SI. Raises `SentenceError` unless the word `by` takes its unit and sign."""
    if given.unit is None:
        raise SentenceError(given.column, f"{quoted(given.text)} has no unit.", map(such_as, takes.units))
    si = UNITS[given.unit].si
    if si not in takes.units:
        kinds = " or ".join(KINDS[u].word for u in takes.units)
        message = f"{by} takes {kinds}; {quoted(given.text)} is {KINDS[si].word}."
        raise SentenceError(given.column, message, map(such_as, takes.units))
    value = _to_si(given, given.unit)
    negative, nothing = takes.sense in ("any", "not nothing"), takes.sense in ("any", "not negative")
    if (value < 0 and not negative) or (value == 0 and not nothing):
        message = f"{by} {quoted(given.text)} makes no sense: it must be {takes.sense}."
        raise SentenceError(given.column, message, [such_as(si)])
    if si == "rad" and abs(value) > math.radians(takes.most_deg) + ROUNDING_RAD:
        message = f"{by} {quoted(given.text)} makes no sense: from -{takes.most_deg:g} to {takes.most_deg:g} DEG."
        raise SentenceError(given.column, message, [such_as(si)])
    if si == "ratio" and value > 1:
        raise SentenceError(
            given.column, f"{by} {quoted(given.text)} makes no sense: at most 100 PERCENT.", ["100 PERCENT"]
        )
    return Quantity(value, si)


def in_one_unit(last_first: list[WrittenNumber]) -> list[tuple[WrittenNumber, str | None]]:
    """Each number in order, with its own unit or that of the next number with a unit (`60 -20 35 CM`).

    A list without any unit is in SI. Raises `SentenceError` for a number without a unit after one with a unit.
    """
    unit: str | None = None
    bare: list[WrittenNumber] = []  # the last numbers, without a unit after them
    result = []
    for given in last_first:
        if given.unit is None and unit is None:
            bare.insert(0, given)
        elif bare and unit is None:
            message = f"{quoted(bare[0].text)} has no unit, but the number before it has one."
            with_unit = " ".join(number.text[:20] for number in bare[:MOST_SHOWN])
            raise SentenceError(bare[0].column, message, [f"{with_unit} {given.unit}"])
        unit = given.unit or unit
        result.append((given, unit))
    result.reverse()
    return result


def si_numbers(last_first: list[WrittenNumber], takes: tuple[str, ...], word: Token) -> list[float]:
    """The numbers after JOINTS or POSITION, in SI."""
    if not last_first:
        raise SentenceError(word.end_pos or 0, f"{word.value} needs numbers after it.", ["a number", such_as(takes[0])])
    numbers = in_one_unit(last_first)
    for given, unit in numbers:
        if unit is None:
            _refuse_beyond(given, given.number, takes[0])
    return in_si(numbers, takes, word.value)


def positions(last_first: list[WrittenNumber], word: Token) -> list[float]:
    """The lengths after POSITION, in m. Raises `SentenceError`, at the last number, if none has a unit."""
    values = si_numbers(last_first, LENGTH.units, word)
    if all(given.unit is None for given in last_first):
        raise SentenceError(last_first[0].column, f"{quoted(last_first[0].text)} has no unit.", [such_as("m")])
    return values


def in_si(numbers: list[tuple[WrittenNumber, str | None]], units: tuple[str, ...], by: str) -> list[float]:
    """The numbers in SI. Raises `SentenceError`, at the number, for a unit that is not among `units`."""
    for given, _ in numbers:
        if given.unit is not None:
            checked(given, QuantityRule(units, "any"), by)
    return [given.number + 0.0 if unit is None else _to_si(given, unit) for given, unit in numbers]


def _to_si(given: WrittenNumber, unit: str) -> float:
    """The value in SI. Raises `SentenceError` for one that no planner could compute with, nor any arm perform."""
    value = to_si(given.number, unit)
    _refuse_beyond(given, value, UNITS[unit].si)
    return value


def _refuse_beyond(given: WrittenNumber, value: float, si: str) -> None:
    kind = KINDS[si]
    if abs(value) > kind.most or 0.0 < abs(value) < LEAST:
        size = "large" if abs(value) > kind.most else "small"
        message = f"{quoted(given.text)} is too {size} a number for {kind.word}."
        raise SentenceError(given.column, message, [such_as(si)])


def check_angles(numbers: Iterable[tuple[WrittenNumber, str | None]], by: str) -> None:
    """Raises `SentenceError`, at the number, for an angle that is not one of an attitude."""
    for given, unit in numbers:
        if unit is not None and UNITS[unit].si == "rad":
            checked(given._replace(unit=unit), ATTITUDE, by)
