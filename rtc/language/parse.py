"""The parser: from one sentence to its record or a located refusal. No sentence makes it raise.

Pure, except `default_grammar`, which reads the grammar of this package once. Names are not looked up here: the
language does not know which objects exist.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from importlib import resources

from lark.exceptions import UnexpectedToken

from rtc.language.complain import Stop, complaint
from rtc.language.grammar import END, Grammar
from rtc.language.refuse import SentenceError
from rtc.language.words import Word, one_line
from rtc.protocol.outcomes import Refusal
from rtc.protocol.sentence import ParsedCommand

__all__ = ["Grammar", "default_grammar", "parse"]


def parse(grammar: Grammar, sentence: str | bytes) -> ParsedCommand | Refusal:
    """The record of one sentence (R117), or a refusal with the column of the first offending character."""
    text = one_line(sentence)
    if isinstance(text, Refusal):
        return text
    feed = grammar.begin().feed_token
    words = grammar.vocabulary.words(text)
    taken: list[Word] = []
    word = _end(taken)
    try:
        for word in words:
            feed(word)
            taken.append(word)
        word = _end(taken)
        fields = feed(word)
    except SentenceError as wrong:
        return wrong.refusal
    except UnexpectedToken:
        return complaint(Stop(grammar, text, taken, word, _next(words)))
    return ParsedCommand(**fields)


@lru_cache(maxsize=1)
def default_grammar() -> Grammar:
    """The grammar of this package, compiled once per process."""
    return Grammar(resources.files("rtc.language").joinpath("command.lark").read_text("utf-8"))


def _end(taken: list[Word]) -> Word:
    """The end-of-sentence token, placed after the last word: an incomplete sentence is refused at that column."""
    column = (taken[-1].end_pos or 0) if taken else 0
    return Word(END, "", column, column)


def _next(words: Iterator[Word]) -> Word | None:
    try:
        return next(words, None)
    except SentenceError:
        return None
