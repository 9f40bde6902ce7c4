"""Locations in YAML files: the path in an error message (`$.scripts[13].steps[2].stop`), and the line of a path."""

from __future__ import annotations

import re
from typing import Any

import yaml

PLACE = re.compile(r"\$((?:\.[\w/-]+|\[\d+\])+)")
PART = re.compile(r"\.([\w/-]+)|\[(\d+)\]")

Path = list[str | int]


def path_of(message: str) -> Path:
    """The first path in a message, as keys and indices; empty without a path."""
    found = PLACE.search(message)
    return [int(index) if index else key for key, index in PART.findall(found[1])] if found else []


def line_of(text: bytes, path: Path) -> int:
    """The line (from 1) of the value at this path, or of the innermost enclosing value that exists."""
    node = yaml.compose(text, yaml.CSafeLoader)
    for part in path:
        inner = _inner(node, part)
        if inner is None:
            break
        node = inner
    return int(node.start_mark.line) + 1 if node is not None else 1


def _inner(node: Any, part: str | int) -> Any:
    if isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
        return node.value[part]
    if isinstance(node, yaml.MappingNode):
        return next((value for key, value in node.value if getattr(key, "value", None) == part), None)
    return None
