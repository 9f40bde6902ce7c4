"""Error messages of the parser: the place of the fault, the words expected there, the word probably meant.

Runs only for a wrong sentence, so it may take a millisecond. It feeds the correct words to a fresh parser again to
get the exact set of words that can follow them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from lark.exceptions import UnexpectedInput

from rtc.language.grammar import END, Grammar
from rtc.language.hands import ARM_OF_WORD
from rtc.language.refuse import SentenceError, quoted, refusal
from rtc.language.words import Word
from rtc.protocol.outcomes import Refusal
from rtc.protocol.spelling import nearest_words
from rtc.protocol.units import KINDS, UNITS

READABLE = {
    "NAME": "a name",
    "QUANTITY": "a quantity such as 10 CM",
    "NUMBER": "a number",
    "STRING": 'a text in quotes such as "bolt head is stripped"',
}
#: directions, used for a hint only; the workers decide which directions exist
AXES = frozenset({"X", "Y", "Z", "TOOL-X", "TOOL-Y", "TOOL-Z", "UP", "DOWN", "LEFT", "RIGHT", "FORWARD", "BACK"})
HELD_BY = "HELD-BY"  # an attribute whose value is an arm, which SET cannot state; used for a hint only
THE_END = "the end of the sentence"
A_UNIT, A_TIME = "a unit such as CM", "a unit of time such as SEC"
OF_TIME = frozenset({"FOR", "TIME_LIMIT", "EVERY"})  # words before a number of seconds
LOOK_BACK = 6  # number of words before the fault that are tested for a misspelling


class Stop:
    """Where the parse stopped: `word` cannot follow `before`. `following` is the next word, if known."""

    def __init__(self, grammar: Grammar, text: str, before: Sequence[Word], word: Word, following: Word | None) -> None:
        self.grammar = grammar
        self.text = text
        self.before = before
        self.word = word
        self.following = following
        self.allowed = allowed_after(grammar, before)

    def written(self, word: Word) -> str:
        """The word as the user wrote it: a synonym is repeated as that synonym."""
        text = self.text[word.start_pos : word.end_pos]
        return quoted(text if word.type == "STRING" else text.upper())

    def opening(self) -> bool:
        """True before the verb."""
        return all(word.type == "TEST" for word in self.before)


def complaint(stop: Stop) -> Refusal:
    """The refusal with the most specific explanation that fits."""
    return _unit_fault(stop) or _states_holder(stop) or _misspelt_before(stop) or _misplaced(stop)


def allowed_after(grammar: Grammar, words: Sequence[Word]) -> set[str]:
    """The terminals that may follow these words, which must be correct so far."""
    parser = grammar.begin()
    for word in words:
        parser.feed_token(word)
    return parser.accepts()  # type: ignore[no-untyped-call]


def readable(grammar: Grammar, allowed: Collection[str], before: Sequence[Word]) -> list[str]:
    """Terminals that may follow as text: token classes, then sorted reserved words, the end of the sentence last."""
    texts = {kind: [text] for kind, text in READABLE.items() if kind in allowed}
    if "QUANTITY" in texts:
        texts["QUANTITY"] = quantities(grammar, before)
    classes = [text for several in texts.values() for text in several]
    words = sorted(grammar.reserved[t] for t in allowed if t in grammar.reserved)
    return classes + words + ([THE_END] if END in allowed else [])


def quantities(grammar: Grammar, before: Sequence[Word]) -> list[str]:
    """The quantities that may stand after these words, each with an example.

    A mass fits no clause, so the refusal of a mass names what fits. Where a mass is accepted, any quantity is.
    """
    mass = Word("QUANTITY", KINDS["kg"].example, 0, 0)
    parser = grammar.begin()
    try:
        for word in [*before, mass]:
            parser.feed_token(word)
        follows = parser.accepts()  # type: ignore[no-untyped-call]
        end = END if END in follows else "THEN"  # the next word, at which the parser checks the quantity
        parser.feed_token(Word(end, end, 0, 0))
    except SentenceError as wrong:
        return wrong.refusal.expected
    except UnexpectedInput:  # a grammar of other clauses
        pass
    return [READABLE["QUANTITY"]]


def nearest(grammar: Grammar, written: str, allowed: Collection[str]) -> list[str]:
    """The reserved words and synonyms that resemble the written word and may stand here."""
    spellings = grammar.vocabulary.reserved
    return nearest_words(written, [spelling for spelling, (terminal, _) in spellings.items() if terminal in allowed])


def _unit_fault(stop: Stop) -> Refusal | None:
    """A number without a unit, or with an unknown one."""
    word, following = stop.word, stop.following
    if word.type == "NAME" and stop.before and stop.before[-1].type == "NUMBER":
        return _no_unit(stop, word)
    if word.type == "NUMBER" and "QUANTITY" in stop.allowed:
        if following is not None and following.type == "NAME":
            return _no_unit(stop, following)
        expected = quantities(stop.grammar, stop.before)
        return refusal(word.start_pos or 0, f"{stop.written(word)} has no unit.", expected)
    return None


def _no_unit(stop: Stop, word: Word) -> Refusal:
    near = nearest_words(word.value, UNITS)
    last = next((one.type for one in reversed(stop.before) if one.type != "NUMBER"), "")
    expected = A_TIME if last in OF_TIME else A_UNIT
    return refusal(word.start_pos or 0, f"{stop.written(word)} is not a unit.", [expected], near)


def _misspelt_before(stop: Stop) -> Refusal | None:
    """A misspelt reserved word that was read as a name, so that the error appeared at a later word."""
    grammar, before = stop.grammar, stop.before
    spellings = grammar.vocabulary.reserved
    for i in range(len(before) - 1, max(len(before) - LOOK_BACK, 0) - 1, -1):
        suspect = before[i]
        if suspect.type != "NAME":
            continue
        for spelling in nearest_words(suspect.value, spellings):
            terminal, value = spellings[spelling]
            meant = Word(terminal, value, suspect.start_pos or 0, suspect.end_pos or 0)
            if _fits(grammar, [*before[:i], meant, *before[i + 1 :], stop.word]):
                expected = readable(grammar, allowed_after(grammar, before[:i]), before[:i])
                written = stop.written(suspect)
                message = f"{written} is read as a name here, and the rest does not fit. Did you mean {spelling}?"
                return refusal(suspect.start_pos or 0, message, expected, [spelling])
    return None


def _fits(grammar: Grammar, words: Sequence[Word]) -> bool:
    parser = grammar.begin()
    try:
        for word in words:
            parser.feed_token(word)
    except (UnexpectedInput, SentenceError):
        return False
    return True


def _meant(stop: Stop, word: Word) -> list[str]:
    """A blank for a hyphen (RIGHT ARM), an axis without ALONG, or ABOUT instead of ALONG."""
    spellings = stop.grammar.vocabulary.reserved
    if stop.following is not None:
        joined = f"{word.value}-{stop.following.value}"
        if joined in spellings and spellings[joined][0] in stop.allowed:
            return [joined]
    if "ALONG" in stop.allowed and word.value == "ABOUT":
        return ["ALONG"]
    if "ALONG" in stop.allowed and word.value in AXES:
        return [f"ALONG {word.value}"]
    return []


def _states_holder(stop: Stop) -> Refusal | None:
    """`SET object HELD-BY arm`, whose attribute is right and whose value cannot be stated."""
    before = stop.before
    if len(before) <= 2 or before[-3].type != "SET" or before[-1].value != HELD_BY or stop.word.type == END:
        return None
    thing, attribute = stop.written(before[-2]), stop.written(before[-1])
    message = f"{attribute} is measured and cannot be stated."
    does = [f"GRASP {thing}, to take it", f"VERIFY {thing} AT the arm that holds it"]
    return refusal(before[-1].start_pos or 0, message, does)


def _misplaced(stop: Stop) -> Refusal:
    word = stop.word
    near = []
    if word.type == END:
        message = (
            "There is no command in this sentence."
            if stop.opening()
            else f"The sentence ends too early, after {stop.written(stop.before[-1])}."
        )
    else:
        written = stop.written(word)
        near = _meant(stop, word) or nearest(stop.grammar, word.value, stop.allowed)
        if stop.opening():
            message = f"{written} is not a verb of the language."
        elif word.value in ARM_OF_WORD.values() and "NAME" in stop.allowed and len(stop.before) == 1:
            message = f"{stop.written(stop.before[-1])} needs the name of an object; {written} is an arm."
        elif word.type in stop.grammar.reserved and "NAME" in stop.allowed:
            message = f"{written} is a reserved word and cannot be a name, after {stop.written(stop.before[-1])}."
        else:
            message = f"{written} cannot stand here, after {stop.written(stop.before[-1])}."
            if word.type == "THROUGH" and stop.before[-1].type in ("STRAIGHT_LINE", "JOINT_MOTION"):
                message += f" Write THROUGH and its place before {stop.written(stop.before[-1])}."
            if word.type == "NAME" and "ARM" in stop.allowed and not near:
                message += f" If it is an arm, write ARM {written}."
    return refusal(word.start_pos or 0, message, readable(stop.grammar, stop.allowed, stop.before), near)
