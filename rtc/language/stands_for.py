"""Words that are not reserved, and yet stand for something in a sentence: they are no names. Pure."""

from __future__ import annotations

import re

OF_COMMAND = re.compile(r"C-\d+$", re.ASCII)
#: commands, values of SET, what SHOW shows, units
STANDS_FOR = frozenset(
    {
        *("ALL", "LAST", "HERE", "NONE", "UNKNOWN", "INITIAL", "SAVED", "WORLD", "OPERATOR", "RESOURCES"),
        *("N", "NM", "KG", "G", "M", "CM", "MM", "DEG", "RAD", "SEC", "S", "MIN"),
    }
)


def stands_for_something(name: str) -> bool:
    return name in STANDS_FOR or OF_COMMAND.match(name) is not None
