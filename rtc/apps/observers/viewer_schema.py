"""JSON schemas of messages in the form that robot viewers understand. Pure.

Viewers of the Foxglove family read neither `$ref` nor `anyOf`, and want a `type` everywhere. So references are
replaced by what they name, an optional value has the schema of its value, and a map has no listed properties. A type
within itself is a map.
"""

from __future__ import annotations

from typing import Any

import msgspec

ANY = {"type": "object", "properties": {}}  # a value of any kind, or a map


def viewer_schema(kind: Any) -> dict[str, Any]:
    """The JSON schema of a message type without references and alternatives."""
    whole = msgspec.json.schema(kind)
    return _plain(whole, whole.get("$defs", {}))


def _plain(part: dict[str, Any], named: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """`named`: the types that a reference may name, without those that contain this part."""
    if "$ref" in part:
        name = part["$ref"].rpartition("/")[2]
        if name not in named:
            return dict(ANY)
        return _plain(named[name], {other: inner for other, inner in named.items() if other != name})
    if "anyOf" in part:
        kinds = [kind for kind in part["anyOf"] if kind.get("type") != "null"]
        return _plain(kinds[0], named) if len(kinds) == 1 else dict(ANY)
    about = {key: part[key] for key in ("title", "description") if key in part}
    if "enum" in part:
        return about | {"type": "string", "enum": part["enum"]}
    match part.get("type"):
        case "object":
            properties = {name: _plain(inner, named) for name, inner in part.get("properties", {}).items()}
            return about | {"type": "object", "properties": properties}
        case "array":
            return about | {"type": "array", "items": _plain(part.get("items") or {}, named)}
        case None:
            return about | ANY
        case simple:
            return about | {"type": simple}
