"""Locations in YAML files: the path in an error message (`$.scripts[13].steps[2].stop`), and the line of a path."""

from __future__ import annotations

import re
from typing import Any

import msgspec
import msgspec.inspect
import yaml

from rtc.model.cells.yaml_reader import nodes

PLACE = re.compile(r"\$((?:\.[\w/-]+|\[\d+\])+)")
PART = re.compile(r"\.([\w/-]+)|\[(\d+)\]")

Path = list[str | int]


def path_of(message: str) -> Path:
    """The first path in a message, as keys and indices; empty without a path."""
    found = PLACE.search(message)
    return [int(index) if index else key for key, index in PART.findall(found[1])] if found else []


def line_of(text: bytes, path: Path) -> int:
    """The line (from 1) of the value at this path, or of the innermost enclosing value that exists."""
    node = nodes(text)
    for part in path:
        inner = _inner(node, part)
        if inner is None:
            break
        node = inner
    return int(node.start_mark.line) + 1 if node is not None else 1


def line_of_key(text: bytes, path: Path) -> int:
    """The line (from 1) of the last key of this path, which may be above its value."""
    node = nodes(text)
    for part in path[:-1]:
        node = _inner(node, part)
    pairs = node.value if isinstance(node, yaml.MappingNode) else []
    found = next((key for key, _ in pairs if getattr(key, "value", None) == path[-1]), None)
    return int(found.start_mark.line) + 1 if found is not None else line_of(text, path)


def known_keys(schema: Any, path: Path) -> list[str]:
    """The keys of the map at this path of a document, sorted; empty if its type has no fixed keys."""
    types = _alternatives(msgspec.inspect.type_info(schema))
    for part in path:
        types = [inner for one in types for inner in _alternatives(_type_within(one, part))]
    return sorted({f.encode_name for one in types if isinstance(one, msgspec.inspect.StructType) for f in one.fields})


def _type_within(one: Any, part: str | int) -> Any:
    if isinstance(one, msgspec.inspect.StructType):
        return next((field.type for field in one.fields if field.encode_name == part), None)
    return getattr(one, "item_type", None) or getattr(one, "value_type", None)


def _alternatives(one: Any) -> list[Any]:
    return list(one.types) if isinstance(one, msgspec.inspect.UnionType) else [one]


def _inner(node: Any, part: str | int) -> Any:
    if isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
        return node.value[part]
    if isinstance(node, yaml.MappingNode):
        return next((value for key, value in node.value if getattr(key, "value", None) == part), None)
    return None
