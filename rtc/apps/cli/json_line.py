"""The result of a command as one line of JSON. Imports little: `rtc halt` prints with it."""

from __future__ import annotations

import json
import sys
from typing import Any

import msgspec


def emit_json(value: Any) -> None:
    """Print the result as one line of JSON on stdout; characters that a terminal interprets are escaped."""
    line = msgspec.json.encode(value).decode()
    if not line.isprintable():
        line = "".join(c if c.isprintable() else _escaped(c) for c in line)
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _escaped(character: str) -> str:
    """Escape for a JSON string; json.dumps does not escape DEL."""
    return "\\u007f" if character == "\x7f" else json.dumps(character)[1:-1]
