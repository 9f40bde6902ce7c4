"""Completion: the words that may stand at the end of an unfinished sentence.

Pure. The caller gives the existing names; the grammar gives the rest.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

from lark.exceptions import UnexpectedInput

from rtc.language.complain import allowed_after
from rtc.language.grammar import Grammar
from rtc.language.quantities import AMOUNTS, CONSTRAINTS, JOINTS, LENGTH, MEASURES, PERIOD, STEP, TIME, QuantityRule
from rtc.language.refuse import SentenceError
from rtc.language.words import TOKEN_CLASSES, Word, one_line
from rtc.protocol.outcomes import Refusal
from rtc.protocol.units import UNITS

#: the existing names, or a function that returns those that fit after the given words (in capitals)
Names = Iterable[str] | Callable[[list[str]], Iterable[str]]

LAST = "LAST"  # refers to the previous command
COMMAND_FOLLOWS = ("AFTER", "TOGETHER_WITH")
_UNFINISHED = re.compile(r"[A-Za-z0-9_%/-]*$")
#: the word before a number -> the quantities it takes; for BY the verb decides
_TAKES: dict[str, QuantityRule] = {
    **CONSTRAINTS,
    **MEASURES,
    "FOR": TIME,
    "EVERY": PERIOD,
    "JOINTS": JOINTS,
    "POSITION": LENGTH,
}
_BY: dict[str, QuantityRule] = {**AMOUNTS, "MOVE": STEP}


def complete(grammar: Grammar, text_so_far: str, names: Names = ()) -> list[str]:
    """The words that may stand at the end, in capitals, sorted; each begins with the last word typed.

    Empty where nothing can follow, inside quotes and comments, and after an error.
    """
    unfinished = _UNFINISHED.search(text_so_far)
    beginning = unfinished[0] if unfinished else ""
    words = _whole_words(grammar, text_so_far[: len(text_so_far) - len(beginning)])
    if words is None:
        return []
    allowed = _allowed(grammar, words)
    choices = {grammar.reserved[t] for t in allowed if t in grammar.reserved}
    if "NAME" in allowed:
        reserved = grammar.vocabulary.reserved
        known = names([word.value for word in words]) if callable(names) else names
        choices |= {n for n in map(_spelt, known) if n not in reserved}
    if words and words[-1].type in COMMAND_FOLLOWS:
        choices.add(LAST)
    if words and words[-1].type == "NUMBER" and "QUANTITY" in _allowed(grammar, words[:-1]):
        choices |= set(_units(words))
    prefix = _spelt(beginning)
    return sorted(c for c in choices if c.startswith(prefix))


def _allowed(grammar: Grammar, words: list[Word]) -> set[str]:
    try:
        return allowed_after(grammar, words)
    except (UnexpectedInput, SentenceError):
        return set()


def _spelt(word: str) -> str:
    return word.upper().replace("_", "-")


def _whole_words(grammar: Grammar, text: str) -> list[Word] | None:
    """The words before the unfinished one; None inside quotes or comments, after the end, and after an error."""
    line = one_line(text)
    if isinstance(line, Refusal) or "--" in _without_quotes(line) or line.rstrip(" \t,").endswith("."):
        return None
    try:
        return list(grammar.vocabulary.words(line))
    except SentenceError:
        return None


def _without_quotes(line: str) -> str:
    return re.sub(r'"[^"]*"', "", line)


def _units(words: list[Word]) -> list[str]:
    """The units that fit the words before the number; all units when the words do not determine them."""
    reserved = [w.value for w in words if w.type not in TOKEN_CLASSES]
    word, previous = reserved[-1], reserved[-2:-1]
    if word in ("BY", "TO"):  # after BACK-OFF and AVOID-NEIGHBORS a length; else the verb decides
        takes = LENGTH if previous in (["BACK-OFF"], ["AVOID-NEIGHBORS"]) else _BY.get(_verb(reserved))
    elif word in ("EXCEEDS", "BELOW"):
        takes = next((MEASURES[w] for w in reversed(reserved) if w in MEASURES), None)
    else:
        takes = _TAKES.get(word)
    return [u for u, unit in UNITS.items() if takes is None or unit.si in takes.units]


def _verb(words: list[str]) -> str:
    return next(word for word in words if word != "TEST")
