"""The words of hands: data that agrees with the grammar."""

from __future__ import annotations

from rtc.language.dictionary import clauses
from rtc.language.hands import ARM_OF_WORD, OWN_WORDS, hand_in_words
from rtc.language.parse import default_grammar, parse
from rtc.protocol.sentence import BOTH_ARMS, ParsedCommand


def test_the_words_of_hands_are_those_of_the_grammar() -> None:
    alternatives = [*clauses()["hand"], *clauses()["end-effector"]]
    words = {symbols[0] for symbols in alternatives if len(symbols) == 1 and symbols[0] not in clauses()}
    assert {*ARM_OF_WORD, BOTH_ARMS} == words


def test_each_word_stands_for_its_arm_in_a_sentence() -> None:
    for word, arm in ARM_OF_WORD.items():
        parsed = parse(default_grammar(), f"STOW {word}")
        assert isinstance(parsed, ParsedCommand)
        assert parsed.hand == arm
        assert hand_in_words(arm) == arm
        assert arm in OWN_WORDS


def test_any_other_arm_follows_the_word_arm() -> None:
    assert hand_in_words("ELBOW") == "ARM ELBOW"
    assert hand_in_words("") == ""
