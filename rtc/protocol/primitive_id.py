"""The names of primitives: `C-3.1@k7f2` is the first primitive of command C-3, made in the life k7f2 of the journal.

A broker that lost its journal may number commands as one before it did. The life keeps an old report from answering a
new primitive. A journal without a life (in tests) makes plain names, `C-3.1`. Pure.
"""

from __future__ import annotations

import re

LONGEST = 200  # characters, as of every name in a message
_ID = re.compile(r"(C-\d+)\.(\d+)(?:@(\w+))?", re.ASCII)


def primitive_id(command: str, n: int, life: str = "") -> str:
    """The name of the n-th primitive (from 1) of a command."""
    return f"{command}.{n}" + (f"@{life}" if life else "")


def command_of(primitive: str) -> str:
    """C-3 of C-3.1@k7f2. Of a name of another form: what stands before its first point."""
    return primitive.partition(".")[0]


def belongs_to(primitive: str, command: str, n: int, life: str = "") -> bool:
    """Whether this is the name that the broker asked the binder for."""
    return primitive == primitive_id(command, n, life)


def number_of(primitive: str) -> int:
    """3 of C-3.1@k7f2; 0 of a name of another form."""
    found = _ID.fullmatch(primitive)
    return int(found[1].removeprefix("C-")) if found else 0


def is_name(primitive: str) -> bool:
    """Whether it has the form of a primitive's name, with or without a life."""
    return len(primitive) <= LONGEST and _ID.fullmatch(primitive) is not None
