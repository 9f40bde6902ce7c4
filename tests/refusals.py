"""The typed facts of a refusal by name, for tests that refuse many sentences."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rtc.protocol.outcomes import Refusal


def stated(refusal: Refusal | None, names: Iterable[str]) -> dict[str, Any]:
    """Its facts by these names: `reason`, `where`, `column`, `expected`, `cause` and the figures of that."""
    assert refusal is not None
    own = {name: getattr(refusal, name) for name in ("reason", "where", "column", "expected")}
    found = {**own, **refusal.figures()}
    return {name: found.get(name) for name in names}
