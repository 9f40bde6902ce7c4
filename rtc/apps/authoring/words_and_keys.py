"""Faults of a cell file that its types do not show: names that no sentence can use, keys given twice, odd gravity."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import yaml

from rtc.language.hands import ARM_OF_WORD
from rtc.language.parse import default_grammar
from rtc.language.stands_for import stands_for_something
from rtc.model.cells.yaml_reader import nodes

#: pattern of a type -> what it means, for people
PATTERNS = {
    "^[A-Z][A-Z0-9]*(-[A-Z0-9]+)*$": "a name of capital letters, digits and hyphens is expected, such as MY-CUBE-1",
    "^[-+]?[0-9]+(\\\\.[0-9]+)? m$": "a number and its unit is expected, such as 0.5 m",
    "^[0-9]+(\\\\.[0-9]+)? m/s2$": "a number and its unit is expected, such as 1 m/s2",
}

Row = tuple[str, str, str, str]  # place, problem, severity, expected


def name_problem(arm: str) -> str:
    """Why sentences cannot use this name of an arm; empty if they can."""
    pattern = next(iter(PATTERNS))
    if not re.match(pattern, arm):
        return PATTERNS[pattern]
    return "" if arm in ARM_OF_WORD or not _is_taken(arm) else reserved_name_problem(arm)


def _is_taken(name: str) -> bool:
    """Whether it stands for something else at a place where a sentence may have it."""
    return name in default_grammar().vocabulary.reserved or stands_for_something(name)


def reserved_name_problem(word: str) -> str:
    return f"{word} is a word of the command language: no sentence can use it as a name"


def readable(message: str) -> str:
    """A message of the decoder, with words instead of a pattern."""
    return next((words for pattern, words in PATTERNS.items() if pattern in message), message)


def faults(plain: Any) -> Iterator[Row]:
    """Names that are words of the language, which a sentence reads otherwise; and a gravity that points upwards."""
    if not isinstance(plain, dict):
        return
    for where, name in _names(plain):
        if isinstance(name, str) and _is_taken(name) and not (where.startswith("arms") and name in ARM_OF_WORD):
            yield where, reserved_name_problem(name), "error", "another name"
    gravity = plain.get("gravity_m_s2")
    if isinstance(gravity, list) and len(gravity) == 3 and isinstance(gravity[2], int | float) and gravity[2] > 0.0:
        yield "gravity_m_s2", "it points upwards, as z does", "warning", "[0, 0, -9.81] on earth, [0, 0, 0] in orbit"


def duplicate_keys(text: bytes) -> Iterator[tuple[str, str, int]]:
    """(place, problem, line) of every key that a map has more than once; the reader takes the last without a word."""
    yield from _repeated(nodes(text), "", set())


def _repeated(node: yaml.Node | None, path: str, done: set[int]) -> Iterator[tuple[str, str, int]]:
    """`done`: nodes so far by their ids, because aliases repeat them."""
    if id(node) in done:
        return
    done.add(id(node))
    if isinstance(node, yaml.SequenceNode):
        for n, part in enumerate(node.value):
            yield from _repeated(part, f"{path}[{n}]", done)
    if isinstance(node, yaml.MappingNode):
        lines: dict[str, int] = {}
        for key, value in node.value:
            place, line = f"{path}.{key.value}".lstrip("."), key.start_mark.line + 1
            if place in lines:
                yield place, f"it is given twice; the first is in line {lines[place]}", line
            lines.setdefault(place, line)
            yield from _repeated(value, place, done)


def _names(plain: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    for group in ("arms", "seats", "objects", "places", "regions", "cameras"):
        for n, part in enumerate(_list(plain.get(group))):
            yield f"{group}[{n}].name", part.get("name")
            yield f"{group}[{n}].end_effector", part.get("end_effector")
            for m, point in enumerate(_list(part.get("grasp_points"))):
                yield f"{group}[{n}].grasp_points[{m}].name", point.get("name")
    attitudes = plain.get("attitudes")
    for name in attitudes if isinstance(attitudes, dict) else ():
        yield f"attitudes.{name}", name


def _list(value: Any) -> list[dict[str, Any]]:
    return [part for part in value if isinstance(part, dict)] if isinstance(value, list) else []
