"""An unmet precondition of a script."""

from __future__ import annotations

from typing import NamedTuple


class UnmetPrecondition(NamedTuple):
    """An unmet precondition, the object or arm that causes it, and the row of `needs` that clears it (else its own)."""

    message: str
    held: str
    row: str = ""
    thing: str = ""  # the object to let go of, if it is not `held`
