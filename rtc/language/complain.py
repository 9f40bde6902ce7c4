"""From a parse that stopped to words that help: where it stopped, what would have been right, what was meant.

Runs only when a sentence is wrong, so it may take a millisecond: it says the good words again to a fresh
parser to learn exactly what could have followed them.
"""

from __future__ import annotations

import difflib
from collections.abc import Collection, Sequence

from lark.exceptions import UnexpectedInput

from rtc.language.grammar import END, Grammar
from rtc.language.refuse import Wrong, quoted, refusal
from rtc.language.units import UNITS
from rtc.language.words import Word
from rtc.outcomes import Refusal

READABLE = {
    "NAME": "a name",
    "QUANTITY": "a quantity such as 10 CM",
    "NUMBER": "a number",
    "STRING": 'a text in quotes such as "bolt head is stripped"',
}
THE_END = "the end of the sentence"
A_UNIT = "a unit such as CM"

ALIKE = 0.6  # difflib's ratio: GRAPS and GRASP have 0.8
VERY_ALIKE = 0.75  # for words that would be right as names, and for words that can not stand there anyway
LOOK_BACK = 6  # how many words before the fault may be the misspelt one
MAX_NEAREST = 3


def complaint(grammar: Grammar, before: Sequence[Word], word: Word, following: Word | None) -> Refusal:
    """Why `word` can not follow `before`. `following` is the word after it, if it is known."""
    allowed = allowed_after(grammar, before)
    return (
        _unit_fault(before, word, following, allowed)
        or _misspelt_before(grammar, before, word)
        or _misplaced(grammar, before, word, allowed)
    )


def allowed_after(grammar: Grammar, words: Sequence[Word]) -> set[str]:
    """The terminals that may follow these words (which are known to be right so far)."""
    parser = grammar.begin()
    for word in words:
        parser.feed_token(word)
    return parser.accepts()


def readable(grammar: Grammar, allowed: Collection[str]) -> list[str]:
    """Terminals as a person reads them: kinds of words first, reserved words in order, the end last."""
    classes = [text for kind, text in READABLE.items() if kind in allowed]
    words = sorted(grammar.reserved[t] for t in allowed if t in grammar.reserved)
    return classes + words + ([THE_END] if END in allowed else [])


def nearest(grammar: Grammar, written: str, allowed: Collection[str]) -> list[str]:
    """Reserved words (and synonyms) like the one written: of those that may stand here, or else of all."""
    spellings = grammar.vocabulary.reserved
    here = [spelling for spelling, (terminal, _) in spellings.items() if terminal in allowed]
    return _alike(written, here, ALIKE) or [w for w in _alike(written, spellings, VERY_ALIKE) if w != written]


def _alike(written: str, candidates: Collection[str], cutoff: float) -> list[str]:
    return difflib.get_close_matches(written, candidates, MAX_NEAREST, cutoff)


def _unit_fault(before: Sequence[Word], word: Word, following: Word | None, allowed: Collection[str]) -> Refusal | None:
    """A number without its unit, or with one that is none."""
    if word.type == "NAME" and before and before[-1].type == "NUMBER":
        return _no_unit(word)
    if word.type == "NUMBER" and "QUANTITY" in allowed:
        if following is not None and following.type == "NAME":
            return _no_unit(following)
        message = f"{quoted(word.value)} has no unit."
        return refusal(word.start_pos or 0, message, [READABLE["QUANTITY"]])
    return None


def _no_unit(word: Word) -> Refusal:
    near = _alike(word.value, UNITS, ALIKE)
    return refusal(word.start_pos or 0, f"{quoted(word.value)} is no unit.", [A_UNIT], near)


def _misspelt_before(grammar: Grammar, before: Sequence[Word], word: Word) -> Refusal | None:
    """A misspelt reserved word that passed as a name, so that the next words seemed wrong."""
    for i in range(len(before) - 1, max(len(before) - LOOK_BACK, 0) - 1, -1):
        suspect = before[i]
        if suspect.type != "NAME":
            continue
        spellings = grammar.vocabulary.reserved
        for spelling in _alike(suspect.value, spellings, VERY_ALIKE):
            terminal, value = spellings[spelling]
            meant = Word(terminal, value, suspect.start_pos or 0, suspect.end_pos or 0)
            if _fits(grammar, [*before[:i], meant, *before[i + 1 :], word]):
                allowed = allowed_after(grammar, before[:i])
                message = f"{quoted(suspect.value)} is read as a name here, and then nothing fits. {spelling} would."
                return refusal(suspect.start_pos or 0, message, readable(grammar, allowed), [spelling])
    return None


def _fits(grammar: Grammar, words: Sequence[Word]) -> bool:
    parser = grammar.begin()
    try:
        for word in words:
            parser.feed_token(word)
    except (UnexpectedInput, Wrong):
        return False
    return True


def _misplaced(grammar: Grammar, before: Sequence[Word], word: Word, allowed: Collection[str]) -> Refusal:
    expected = readable(grammar, allowed)
    column = word.start_pos or 0
    if word.type == END:
        if all(w.type == "TEST" for w in before):
            return refusal(column, "There is no command in this sentence.", expected)
        return refusal(column, f"The sentence ends too early, after {quoted(before[-1].value)}.", expected)
    near = nearest(grammar, word.value, allowed)
    if all(w.type == "TEST" for w in before):
        return refusal(column, f"{quoted(word.value)} is no verb of the language.", expected, near)
    if word.type in grammar.reserved and "NAME" in allowed:
        what = f"{quoted(word.value)} is a reserved word and can not be a name"
    else:
        what = f"{quoted(word.value)} can not stand here"
    return refusal(column, f"{what}, after {quoted(before[-1].value)}.", expected, near)
