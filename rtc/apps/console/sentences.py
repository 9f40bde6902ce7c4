"""What a page needs while a sentence is typed: words that may come next, and the error with its place. Pure."""

from __future__ import annotations

from typing import Any

import msgspec

from rtc.language.completion import Names, complete
from rtc.language.parse import Grammar, parse
from rtc.protocol.outcomes import Refusal

MAX_OFFERED = 60


def check(grammar: Grammar, text: str, at: int, names: Names) -> dict[str, Any]:
    """`offers`: words that may stand at character `at`; `refusal`: the error of the whole text, or null."""
    found = parse(grammar, text) if text.strip() else None
    refusal = msgspec.to_builtins(found) if isinstance(found, Refusal) else None
    return {"offers": complete(grammar, text[:at], names)[:MAX_OFFERED], "refusal": refusal}
