"""The names of primitives: `C-3.1@k7f2` is the first primitive of command C-3, made in the life k7f2 of the journal.

A broker that lost its journal may use the command numbers of an earlier broker again. The life tells their primitives
apart, so an old report does not answer a new primitive. Without a life (in tests) names are plain: `C-3.1`. Pure.
"""

from __future__ import annotations

import re

MAX_CHARACTERS = 200  # characters, as of every name in a message
_ID = re.compile(r"(C-\d+)\.(\d+)(?:@(\w+))?", re.ASCII)


def primitive_id(command: str, n: int, life: str = "") -> str:
    """The name of the n-th primitive (from 1) of a command."""
    return f"{command}.{n}" + (f"@{life}" if life else "")


def command_of(primitive: str) -> str:
    """C-3 of C-3.1@k7f2; for a name of another form, the part before its first point."""
    return primitive.partition(".")[0]


def belongs_to(primitive: str, command: str, n: int, life: str = "") -> bool:
    """Whether the binder used the name that the broker requested."""
    return primitive == primitive_id(command, n, life)


def number_of(primitive: str) -> int:
    """3 of C-3.1@k7f2; 0 of a name of another form."""
    found = _ID.fullmatch(primitive)
    return int(found[1].removeprefix("C-")) if found else 0


def seed_of(command: str) -> int:
    """The seed of all sampling for a command: 3 for C-3. A job that is issued again has the same seed."""
    return number_of(primitive_id(command, 1))


def is_name(primitive: str) -> bool:
    """Whether a text has the form of a primitive's name, with or without a life."""
    return len(primitive) <= MAX_CHARACTERS and _ID.fullmatch(primitive) is not None
