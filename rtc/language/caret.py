"""A refused sentence as text for people: the line, a caret under the fault, the expected words.

Returns text and prints nothing. Knows no grammar.
"""

from __future__ import annotations

import textwrap

from rtc.language.refuse import visible
from rtc.protocol.outcomes import Refusal

WIDTH = 100  # columns of the text
MAX_EXPECTED = 20  # words; a longer list (all verbs) is replaced by a reference
INDENT = "  "
CUT = "..."


def show(sentence: str | bytes, refusal: Refusal) -> str:
    """The lines, without a newline at the end. A refusal without a column gets no caret."""
    lines = []
    if refusal.column is not None:
        line, place = _window(_line(sentence), refusal.column)
        lines += [INDENT + line, INDENT + " " * place + "^"]
    lines.append(refusal.message)
    expected = refusal.expected
    if refusal.column is not None and len(expected) > MAX_EXPECTED:
        expected = [f"one of {len(expected)} words; `rtc dictionary` lists the verbs"]
    for label, words in (("expected", expected), ("nearest", refusal.nearest)):
        if words:
            lines.append(_wrapped(f"{label}: ", words))
    return "\n".join(line.rstrip() for line in lines)


def _line(sentence: str | bytes) -> str:
    text = sentence.decode(errors="replace") if isinstance(sentence, bytes) else sentence
    return visible(text.rstrip("\r\n"))


def _window(line: str, column: int) -> tuple[str, int]:
    """The part of the line around the column, and the column's position in that part."""
    room = WIDTH - len(INDENT) - 2 * len(CUT)
    if len(line) <= room:
        return line, column
    begin = min(max(column - room // 2, 0), len(line) - room)
    before, after = CUT if begin else "", CUT if begin + room < len(line) else ""
    return f"{before}{line[begin : begin + room]}{after}", column - begin + len(before)


def _wrapped(label: str, words: list[str]) -> str:
    # Lines must not break inside 'a name' or at a '-': a NUL replaces the blank meanwhile.
    text = ", ".join(w.replace(" ", "\0") for w in words)
    wrapped = textwrap.fill(
        text, WIDTH, initial_indent=label, subsequent_indent=" " * len(label),
        break_on_hyphens=False, break_long_words=False,
    )  # fmt: skip
    return wrapped.replace("\0", " ")
