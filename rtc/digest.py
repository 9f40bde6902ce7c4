"""The name of a program or of a cell: what it says, in 16 hex digits.

A file of its own, because a broker that restarts needs this and nothing else of `rtc.program`, which brings lark, yaml
and numpy: a second or more on a busy machine.
"""

from __future__ import annotations

import hashlib


def digest(body: bytes) -> str:
    """16 hex digits; equal bytes, equal name."""
    return hashlib.sha256(body).hexdigest()[:16]
