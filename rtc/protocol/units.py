"""Units: their spelling in sentences, their SI equivalents in records, and the quantities they measure.

Knows neither clauses nor verbs. Turns are not converted to radians, because bolts are counted in turns.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Unit(NamedTuple):
    si: str  # the SI unit in the record
    times: float = 1.0  # SI value = number * times / over; two factors so that 35 CM is exactly 0.35 m
    over: float = 1.0


class Kind(NamedTuple):
    word: str  # "a length"
    example: str  # "10 CM"
    most: float  # in SI: beyond it, or below LEAST, no number of a sentence is about arms and what they move


UNITS: dict[str, Unit] = {
    "MM": Unit("m", over=1000),
    "CM": Unit("m", over=100),
    "M": Unit("m"),
    "DEG": Unit("rad", times=math.pi, over=180),
    "RAD": Unit("rad"),
    "TURN": Unit("turn"),
    "TURNS": Unit("turn"),
    "N": Unit("N"),
    "NM": Unit("N.m"),
    "N/M": Unit("N/m"),
    "MM/S": Unit("m/s", over=1000),
    "CM/S": Unit("m/s", over=100),
    "M/S": Unit("m/s"),
    "DEG/S": Unit("rad/s", times=math.pi, over=180),
    "RAD/S": Unit("rad/s"),
    "MS": Unit("s", over=1000),
    "SEC": Unit("s"),
    "S": Unit("s"),
    "HZ": Unit("Hz"),
    "KG": Unit("kg"),
    "PERCENT": Unit("ratio", over=100),
    "%": Unit("ratio", over=100),
}

LEAST = 1e-9  # of any quantity but nothing, in SI

KINDS: dict[str, Kind] = {
    "m": Kind("a length", "10 CM", 1e3),
    "rad": Kind("an angle", "90 DEG", 1e4),
    "turn": Kind("a number of turns", "6 TURNS", 1e4),
    "N": Kind("a force", "20 N", 1e6),
    "N.m": Kind("a torque", "3 NM", 1e6),
    "N/m": Kind("a stiffness", "400 N/M", 1e9),
    "m/s": Kind("a speed", "10 CM/S", 1e3),
    "rad/s": Kind("a turning speed", "20 DEG/S", 1e4),
    "s": Kind("a time", "30 SEC", 1e6),
    "Hz": Kind("a rate", "10 HZ", 1e6),
    "kg": Kind("a mass", "2 KG", 1e6),
    "ratio": Kind("a percentage", "50 PERCENT", 1e6),
}

#: SI unit -> the end of a figure's name: width_m, mass_kg
SUFFIXES: dict[str, str] = {
    **{"m": "m", "rad": "rad", "turn": "turns", "s": "s", "N": "n", "N.m": "nm", "N/m": "n_m"},
    **{"m/s": "m_s", "rad/s": "rad_s", "Hz": "hz", "kg": "kg", "ratio": "ratio"},
}


def to_si(number: float, unit: str) -> float:
    """The value in `UNITS[unit].si`. -0.0 becomes 0.0, so that equal records have equal bytes."""
    _, times, over = UNITS[unit]
    return number * times / over + 0.0


#: SI unit -> (unit for display, factor from SI)
_READ: dict[str, tuple[str, float]] = {
    "m": ("mm", 1000.0),
    "rad": ("deg", 180 / math.pi),
    "m/s": ("cm/s", 100.0),
    "rad/s": ("deg/s", 180 / math.pi),
    "ratio": ("percent", 100.0),
    "N.m": ("Nm", 1.0),
}


def in_words(value: float, si: str) -> str:
    """An SI value as text for people: 0.08 m becomes "80 mm"."""
    unit, times = _READ.get(si, (si, 1.0))
    return f"{round(value * times, 6):g} {unit}"


def measured_in_words(value: float, si: str) -> str:
    """As `in_words`, with the three digits that a measured value deserves."""
    unit, times = _READ.get(si, (si, 1.0))
    return f"{figure(value * times)} {unit}"


def figure(value: float, digits: int = 3) -> str:
    """A measured value with so many digits, up to a million without an exponent: 1040, not 1.04e+03."""
    return f"{float(f'{value:.{digits}g}'):g}"


def such_as(si: str) -> str:
    """`a length such as 10 CM`."""
    kind = KINDS[si]
    return f"{kind.word} such as {kind.example}"
