"""Workers and others <-> world database: facts, and changes under a lease."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec

from rtc.protocol.messages.saved import Spread, Validity
from rtc.protocol.messages.shared import Message, Name
from rtc.protocol.messages.worker import Lease
from rtc.protocol.outcomes import Refusal

SHOWN = 80  # characters of a value in `repr`


class WorldChange(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One fact to be written. `key` is LOCATION.attribute, e.g. MACS-OLD.frame. Without a value only the
    validity changes."""

    key: str
    value: Any = None
    validity: Validity = Validity.VALID
    keep_value: bool = False  # leave the value as it is, change the validity
    spread: Spread | None = None  # as of the fact; with `keep_value`, None keeps what it was


class Fact(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    key: str  # LOCATION.attribute
    value: Any
    validity: Validity
    version: int  # of the world when it was written
    source: str  # origin: "cell", "C-7/12", ...
    at_s: float
    spread: Spread | None = None  # of a pose; None = not stated

    def __repr__(self) -> str:
        value = repr(self.value)
        shown = value if len(value) <= SHOWN else f"{value[: SHOWN - 3]}..."
        return f"<Fact {self.key} = {shown}, {self.validity.value}, version {self.version} by {self.source}>"


class ReadView(Message, frozen=True, kw_only=True):
    """One grouped read (R147): all facts, or those of some keys or locations; only facts newer than `since`."""

    request: Name
    keys: Annotated[list[Name], msgspec.Meta(max_length=10_000)] | None = None
    since: int = 0


class View(Message, frozen=True, kw_only=True):
    request: str
    version: int
    facts: list[Fact]  # with their stored validity
    changing: list[str] = []  # keys of those that arms in motion change now, whichever facts were asked for


class Commit(Message, frozen=True, kw_only=True):
    """Write, once per job: the same job again gets the same answer and changes nothing."""

    request: Name
    lease: Lease
    changes: list[WorldChange]
    source: str


class Doubt(Message, frozen=True, kw_only=True):
    """Facts that a motion changes become suspect; the same lease again changes nothing.

    By a lease of the broker for itself: all of them, because it is unknown what was executed. By the lease of an
    analysis that was given up: those of its locations, unless that job has written its changes before."""

    request: Name
    lease: Lease
    why: Name  # becomes the source of the doubt


class Committed(Message, frozen=True, kw_only=True):
    request: str
    version: int


class WorldHistory(Message, frozen=True, kw_only=True):
    request: Name
    key: Name
    limit: int = 100  # at most 1000 are sent


class WorldRefused(Message, frozen=True, kw_only=True):
    request: str
    refusal: Refusal


ToWorld = ReadView | Commit | WorldHistory | Doubt
FromWorld = View | Committed | WorldRefused
