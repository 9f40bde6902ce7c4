"""Advice in words: one text for a line, or one line for each alternative."""

from __future__ import annotations

from collections.abc import Iterable

from rtc.protocol.advice import Alternative

AGAIN = "the same sentence again"


def in_words(one: Alternative) -> str:
    """One alternative: its sentences, and in brackets what a person should know."""
    sentences = ", then ".join([*one.sentences, *([AGAIN] if one.again else [])])
    if not sentences:
        return one.words
    return f"{sentences}{' instead' if one.instead else ''}{f' ({one.words})' if one.words else ''}"


def in_one_line(advice: Iterable[Alternative]) -> str:
    return "; or ".join(map(in_words, advice))
