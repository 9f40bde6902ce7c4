"""What may come next."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtc.language import dictionary
from rtc.language.completion import complete
from rtc.language.parse import default_grammar

GRAMMAR = default_grammar()
NAMES = ["macs_old", "MACS-NEW", "BAY-2", "LIFT"]
HANDS = ["ARM", "BOTH-ARMS", "LEFT-ARM", "LEFT-END-EFF", "RIGHT-ARM", "RIGHT-END-EFF"]
SAMPLES = [line.split(": ", 1)[1] for line in Path(__file__).with_name("samples.txt").read_text().splitlines()]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", sorted(dictionary.verbs())),
        ("TEST ", sorted(dictionary.verbs())),
        ("gra", ["GRASP"]),
        ("GRASP", ["GRASP"]),
        ("GRASP ", ["BAY-2", "LEFT-END-EFF", "MACS-NEW", "MACS-OLD", "RIGHT-END-EFF"]),
        ("GRASP ma", ["MACS-NEW", "MACS-OLD"]),
        ("GRASP macs_n", ["MACS-NEW"]),
        ("MOVE ", HANDS),
        ("MOVE LEFT-ARM to_", ["TO-GRASP-POINT-OF", "TO-NEIGHBORHOOD-OF"]),
        ("GRASP MACS-OLD WITH L", ["LEFT-ARM", "LEFT-END-EFF"]),
        ("INSERT MACS-NEW INTO B", ["BAY-2"]),
        ("GRASP X MAINTAIN SPEED 10 ", ["%", "CM/S", "DEG/S", "M/S", "MM/S", "PERCENT", "RAD/S"]),
        ("GRASP X MAINTAIN SPEED 10 c", ["CM/S"]),
        ("LIFT X BY 10 ", ["CM", "M", "MM"]),
        ("TEST LOOSEN X BY 10 t", ["TURN", "TURNS"]),
        ("LIFT X MAINTAIN AVOID-NEIGHBORS BY 3 ", ["CM", "M", "MM"]),
        ("GRASP X UNLESS FORCE ALONG Z EXCEEDS 3 ", ["N"]),
        ("LOOSEN X UNLESS SLIP THEN BACK-OFF BY 3 ", ["CM", "M", "MM"]),
        ("HOLD LEFT-ARM FOR 3 ", ["MS", "S", "SEC"]),
        ("MOVE LEFT-ARM TO JOINTS 1 2 d", ["DEG"]),
        ("HALT ALL ", []),
        ("GRASP MACS-OLD.", []),
        ("GRASP MACS-OLD -- with ", []),
        ('CANNOT "bo', []),
        ("graps MACS-OLD ", []),
        ("GRASP ; ", []),
        ("HALT\x07 ", []),
    ],
)
def test_completion(text: str, words: list[str]) -> None:
    assert complete(GRAMMAR, text, NAMES) == words


@pytest.mark.parametrize("sample", SAMPLES)
def test_every_reserved_word_of_a_sample_is_offered_where_it_stands(sample: str) -> None:
    words = sample.rstrip(".").split(" ")
    for i, word in enumerate(words):
        word = word.strip(",").upper().replace("_", "-")
        if word in GRAMMAR.vocabulary.reserved:
            assert word in complete(GRAMMAR, " ".join(words[:i]) + " ")


@given(st.text(max_size=60))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_any_text_has_completions_or_none(text: str) -> None:
    for word in complete(GRAMMAR, text, NAMES):
        assert word == word.upper()


def test_units_that_fit_behind_to() -> None:
    assert complete(default_grammar(), "OPEN LEFT-ARM TO 2 ") == ["CM", "DEG", "M", "MM", "RAD"]


def test_after_offers_the_last_command() -> None:
    assert "LAST" in complete(default_grammar(), "STOW LEFT-ARM AFTER ")
    assert complete(default_grammar(), "STOW LEFT-ARM TOGETHER-WITH LA") == ["LAST"]
