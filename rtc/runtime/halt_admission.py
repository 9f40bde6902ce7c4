"""Admission of halts at a server socket: read an order leniently, make it safe, and limit the rate of one caller.

Broker, gateway and MCM use it. It knows neither sockets, clocks nor the client: the time is an argument.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from typing import Any

import msgspec

from rtc.protocol import messages as m
from rtc.protocol.outcomes import Refusal, RefusalReason, WireError
from rtc.protocol.wire import reader
from rtc.runtime.allowance import Allowance

PER_S = 200  # halts of one caller that are answered one by one in a second
MERGE_S = 0.1  # period in which the halts above that rate are merged into one
OWN_NAMES = ("C-", "stop-", "orphan-", "rejoin-", "declined-")  # prefixes of the names of the broker's own halts
NAME_CHARACTERS = 200  # limit of `messages.Name`; the name of a halt is cut to it, and the halt is obeyed

_read_order = reader(m.ToHalt)


class _ScopeOfHalt(msgspec.Struct, tag_field="type", tag="HaltOrder"):
    """The part of a halt that must be readable for the halt to be obeyed: its scope."""

    scope: m.Name = "ALL"
    halt: Any = ""


_read_scope = reader(_ScopeOfHalt)


def read_order(parts: Sequence[bytes]) -> m.HaltOrder:
    """A halt from outside, sanitized. A readable scope is enough: other faulty fields get their defaults.

    `parts` are the frames of the message. Raises WireError if the scope cannot be read either.
    """
    try:
        order: m.HaltOrder = _read_order(parts)
    except WireError as error:
        with contextlib.suppress(WireError):
            found: _ScopeOfHalt = _read_scope(parts)
            name = found.halt[:NAME_CHARACTERS] if isinstance(found.halt, str) else ""
            return sanitize_halt(m.HaltOrder(halt=name, scope=found.scope))
        raise error
    return sanitize_halt(order)


def sanitize_halt(order: m.HaltOrder) -> m.HaltOrder:
    """The order with a safe name and a valid time.

    A scope in small letters is that of capitals, as in a sentence: no name has small ones.
    Names of the broker's own halts are reserved: used by a caller, they could confirm rest of performers that were
    not stopped. Such a halt gets the prefix `H-`. A `called_at_s` that is negative or not finite becomes 0 (unknown).
    So does `received_at_s`: the receiver sets it.
    """
    if order.scope != (scope := order.scope.strip().upper()):
        order = msgspec.structs.replace(order, scope=scope)
    if order.halt.startswith(OWN_NAMES):
        order = msgspec.structs.replace(order, halt=f"H-{order.halt}"[:NAME_CHARACTERS])
    if not 0.0 <= order.called_at_s < math.inf:
        order = msgspec.structs.replace(order, called_at_s=0.0)
    return msgspec.structs.replace(order, received_at_s=0.0) if order.received_at_s else order


def overload(order: m.HaltOrder, why: str) -> m.Declined:
    """The answer to a halt that is obeyed without a report of its rest."""
    message = f"the halt was obeyed, but rest will not be confirmed: {why}"
    return m.Declined(request=order.halt, refusal=Refusal(reason=RefusalReason.OVERLOAD, message=message))


class HaltRateLimiter:
    """Limits the work that one caller can cause by halts. Pure: the time is an argument.

    Halts up to PER_S in a second are handled one by one. Those above that rate are merged: all that arrive within
    MERGE_S become one halt, of their common scope, or of ALL if their scopes differ.
    """

    def __init__(self) -> None:
        self._calls = Allowance(PER_S)  # of each caller
        self._merge_ends_s = 0.0
        self._merged: m.HaltOrder | None = None

    def exceeds(self, caller: bytes, now_s: float) -> bool:
        """Count one halt of `caller`; True if it is above the rate and must go to `merge`."""
        return not self._calls.take(now_s, caller)

    def merge(self, order: m.HaltOrder) -> m.HaltOrder:
        """Add an order to the pending merged halt; the merged halt."""
        before = self._merged
        same = before is None or before.scope == order.scope
        self._merged = order if same else msgspec.structs.replace(order, scope="ALL")  # with the latest times
        return self._merged

    def due(self, now_s: float) -> m.HaltOrder | None:
        """The merged halt, once in MERGE_S; None if there is none or it is not due."""
        if self._merged is None or now_s < self._merge_ends_s:
            return None
        self._merge_ends_s = now_s + MERGE_S
        order, self._merged = self._merged, None
        return order
