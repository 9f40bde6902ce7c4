"""Refusals of the language: a `Refusal` at a column, and the exception that leaves a parse.

Knows no grammar. Text from outside is sanitised here before a message quotes it, so that every message can be
printed and encoded.
"""

from __future__ import annotations

from collections.abc import Iterable

from rtc.protocol.outcomes import Refusal, RefusalReason

MAX_CHARACTERS = 2000  # maximum length of a sentence
MAX_QUOTED = 40  # maximum number of characters that a message quotes


class SentenceError(Exception):
    """Leaves the parse at a fault; `parse` returns its `refusal`.

    Never leaves this package. It is an exception because callbacks of the parser cannot return a refusal.
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
    """The text with one visible character in place of each unprintable one, so that columns are kept."""
    return "".join(_picture(c) for c in text)


def quoted(text: str) -> str:
    """A part of the sentence as a message quotes it: printable, at most MAX_QUOTED characters."""
    text = visible(text)
    return text if len(text) <= MAX_QUOTED else text[: MAX_QUOTED - 3] + "..."


def _picture(character: str) -> str:
    code = ord(character)
    if code < 0x20:
        return " " if character == "\t" else chr(0x2400 + code)
    if code == 0x7F:
        return "\u2421"
    return character if character.isprintable() else "\ufffd"
