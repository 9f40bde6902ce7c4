"""How the language says no: a `Refusal` at a column, and the way out of the middle of a parse.

Knows no grammar. Text from outside is made harmless here before it is quoted: a message can always be
printed and encoded.
"""

from __future__ import annotations

from collections.abc import Iterable

from rtc.outcomes import Refusal, RefusalReason

MAX_CHARACTERS = 2000  # of a sentence
MAX_QUOTED = 40  # characters of a sentence that a message repeats


class Wrong(Exception):
    """Leaves the parse from wherever the fault was seen; `parse` turns it into its refusal at once.

    Never seen outside this package: an exception only because a parser's callbacks have no other way out.
    """

    def __init__(self, column: int, message: str, expected: Iterable[str] = (), nearest: Iterable[str] = ()) -> None:
        super().__init__(message)
        self.refusal = refusal(column, message, expected, nearest)


def refusal(column: int, message: str, expected: Iterable[str] = (), nearest: Iterable[str] = ()) -> Refusal:
    return Refusal(
        reason=RefusalReason.SENTENCE,
        message=message,
        where=f"column {column}",
        column=column,
        expected=list(expected),
        nearest=list(nearest),
    )


def visible(text: str) -> str:
    """The text with one visible character for each that has no shape of its own; columns stay."""
    return "".join(_picture(c) for c in text)


def quoted(text: str) -> str:
    """A piece of the sentence as a message repeats it."""
    text = visible(text)
    return text if len(text) <= MAX_QUOTED else text[: MAX_QUOTED - 3] + "..."


def _picture(character: str) -> str:
    code = ord(character)
    if code < 0x20:
        return " " if character == "\t" else chr(0x2400 + code)
    if code == 0x7F:
        return "\u2421"
    return character if character.isprintable() else "\ufffd"
