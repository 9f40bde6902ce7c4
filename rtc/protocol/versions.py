"""The version of the protocol, and the abilities that a process may announce in its hello.

The version rises if an older peer would misread a message. What an older peer can do without is an ability: a name in
the hello, which the other side tests before it uses it.
"""

from __future__ import annotations

VERSION = 6

ARRAYS = "arrays"  # it reads arrays of messages; else each message travels alone
PAUSES = "pauses"  # a subsystem: it obeys SetPaused; else its commands pause between two steps only
RIGID = "rigid"  # a subsystem: its arms neither comply with a force nor turn bolts; a test refuses such a step
BOXES = "boxes"  # a worker: its collision checks begin with the compiled boxes (decision 0069)


def misfit(peer: str, version: int, own: str) -> str:
    """Why a peer of this version is refused by `own`, with both versions; empty if it fits."""
    if version == VERSION:
        return ""
    return f"{peer} speaks version {version} of the protocol, {own} version {VERSION}"
