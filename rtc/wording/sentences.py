"""A sentence in lines of output."""

from __future__ import annotations

from rtc.language.caret import CUT
from rtc.language.refuse import visible

MAX_QUOTED = 200  # characters of a quoted sentence


def quoted(text: str, most: int = MAX_QUOTED) -> str:
    """A sentence for output: one printable line, at most `most` characters."""
    text = visible(text)
    return text if len(text) <= most else text[: most - len(CUT)] + CUT
