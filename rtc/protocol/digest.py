"""Content digest of a program or cell: its name on the wire, 16 hex digits.

It is apart from `rtc.programs.loader`, so that a restarting broker need not import lark, yaml and numpy. This import
takes a second or more on a busy machine.
"""

from __future__ import annotations

import hashlib


def digest(body: bytes) -> str:
    """The first 16 hex digits of SHA-256."""
    return hashlib.sha256(body).hexdigest()[:16]
