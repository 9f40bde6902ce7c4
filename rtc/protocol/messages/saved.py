"""Facts outside the world database: what a file of `rtc world save` holds, and a sentence brings back."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any

import msgspec

from rtc.protocol.messages.shared import Name
from rtc.protocol.strict import Strict

MAX_FACTS = 10_000  # of one file


class Validity(StrEnum):
    """How far a fact can be relied on (R140). A step that relies on one that is not valid senses it, waits, or is
    refused (`workers.planning.trust`)."""

    UNKNOWN = "unknown"  # neither sensed nor stated; a value is a guess
    VALID = "valid"
    CHANGING = "changing"  # an arm in motion changes it; the value is that before the motion. Never stored
    SUSPECT = "suspect"  # something may have changed it
    INVALID = "invalid"  # sensing has disproved it; the value is the last belief


# The uncertainty of a pose: half-widths of its error along and about the axes of its own frame. They are
# [x y z roll pitch yaw] (m, rad). The truth is believed to lie within these bounds.
Spread = Annotated[list[float], msgspec.Meta(min_length=6, max_length=6)]


class SavedFact(Strict, frozen=True, kw_only=True, omit_defaults=True):
    value: Any
    validity: Validity = Validity.VALID
    spread: Spread | None = None


class SavedWorld(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """The facts of a world at one time, by key, for SET WORLD FACTS SAVED."""

    cell: Name  # digest of the cell that they are about
    facts: Annotated[dict[Name, SavedFact], msgspec.Meta(max_length=MAX_FACTS)]
