"""The W3C trace context of a command: it travels at the end of the name of its request. Pure.

A client chooses the names of its requests, and the broker keeps them in every record. So a trace passes from a client
to an observer, and no process between them must know it: `alice/1f-7;00-0af7…-b7ad…-01`.
"""

from __future__ import annotations

import re
from typing import NamedTuple

MAX_REQUEST = 200  # characters of a request's name (rtc.protocol.messages.Name)
_FORM = re.compile(r"00-(?!0{32})([0-9a-f]{32})-(?!0{16})([0-9a-f]{16})-([0-9a-f]{2})", re.ASCII)


class TraceParent(NamedTuple):
    """The caller's span: identifiers of trace and span, and the flags (1 = sampled)."""

    trace: int
    span: int
    flags: int


def with_traceparent(request: str, traceparent: str) -> str:
    """The request name with a trace context. Raises ValueError for an invalid or too long one."""
    if _FORM.fullmatch(traceparent) is None:
        raise ValueError(f"invalid traceparent {traceparent!r:.80}: it must be 00-TRACE-SPAN-FLAGS, lower case hex")
    joined = f"{request};{traceparent}"
    if len(joined) > MAX_REQUEST:
        raise ValueError(f"no room for a traceparent: the request has {len(joined)} characters; choose a shorter name")
    return joined


def traceparent_of(request: str) -> TraceParent | None:
    """The trace context of a request name; None without one."""
    found = _FORM.fullmatch(request.rpartition(";")[2]) if ";" in request else None
    return TraceParent(int(found[1], 16), int(found[2], 16), int(found[3], 16)) if found else None
