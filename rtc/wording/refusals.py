"""A refusal in lines for people."""

from __future__ import annotations

import re

import msgspec

from rtc.language.caret import show
from rtc.protocol import units
from rtc.protocol.advice import Alternative
from rtc.protocol.outcomes import Refusal
from rtc.wording.advice import in_one_line, in_words


def refusal_lines(refusal: Refusal, text: str = "", *, details: bool = False) -> list[str]:
    """A refusal for people: reason, what is allowed, what would clear it. `details`: also the place and the figures."""
    lines = show(text, _without_repetition(refusal, located=bool(text))).splitlines()
    if details and refusal.where and refusal.column is None:
        lines.append(f"where: {refusal.where}")
    if refusal.owner:
        lines.append(f"owner: {refusal.owner}")
    if details and (figures := _figures(refusal)):
        lines.append(f"figures: {', '.join(figures)}")
    return [*lines, *advice_lines(refusal.clears)]


def advice_lines(advice: list[Alternative]) -> list[str]:
    """The alternatives, with the number that `rtc do --advice` takes if there are several."""
    if len(advice) < 2:
        return [f"to clear it: {in_words(one)}" for one in advice]
    return ["to clear it, one of these:", *(f"  {n}. {in_words(one)}" for n, one in enumerate(advice, 1))]


def _without_repetition(refusal: Refusal, *, located: bool) -> Refusal:
    """For display: the names that `clears` proposes are not listed as nearest too, nor as expected if they are all."""
    advice = in_one_line(refusal.clears)
    proposed = bool(refusal.nearest) and all(name in advice for name in refusal.nearest)
    return msgspec.structs.replace(
        refusal,
        column=refusal.column if located else None,
        nearest=[] if proposed else refusal.nearest,
        expected=[] if proposed and set(refusal.expected) <= set(refusal.nearest) else refusal.expected,
    )


def _figures(refusal: Refusal) -> list[str]:
    """The figures that the message does not contain; numbers without a unit are always shown."""
    rows = [with_unit(*row) for row in refusal.figures().items() if row[0] != "others"]
    return [row for row in rows if not _is_in(row.partition(" ")[2], refusal.message)]


def _is_in(value: str, message: str) -> bool:
    known = re.search(rf"(?<![\w.-]){re.escape(value)}(?![\w-]|\.\d)", message)
    return known is not None and re.search("[A-Za-z]", value) is not None


#: suffix of a figure's name -> SI unit
UNITS = {"_rad_s": "rad/s", "_m_s": "m/s", "_nm": "N.m", "_rad": "rad", "_m": "m", "_n": "N", "_s": "s"}


def with_unit(key: str, value: float | str | tuple[str, ...]) -> str:
    """A figure of a refusal for people: value_rad 0.5 is "value 28.6 deg"."""
    ending = next((ending for ending in UNITS if key.endswith(ending)), "")
    if isinstance(value, tuple):
        return f"{key} {'; '.join(value)}"
    if not ending or isinstance(value, str):
        return f"{key} {figure(value)}"
    number, unit = units.in_words(value, UNITS[ending]).split(" ", 1)
    shown = float(number)
    return f"{key.removesuffix(ending)} {shown:{'.4g' if abs(shown) < 1e4 else '.0f'}} {unit}"


def figure(value: float | str) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
