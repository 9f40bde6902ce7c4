"""The sentences and the picture in docs/language.md are true."""

import re
from pathlib import Path

import pytest

from rtc.language import dictionary
from rtc.language.caret import show
from rtc.language.parse import default_grammar, parse
from rtc.protocol.outcomes import Refusal
from rtc.protocol.sentence import ParsedCommand

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "language.md").read_text("utf-8")
BLOCK = re.search(r"```rtc\n(.*?)```", PAGE, re.DOTALL)
assert BLOCK
SENTENCES = BLOCK[1].splitlines() + re.findall(r"\| `([A-Z][^`]* [^`]*)` \|$", PAGE, re.MULTILINE)


@pytest.mark.parametrize("sentence", SENTENCES)
def test_a_sentence_of_the_page_parses(sentence: str) -> None:
    assert isinstance(parse(default_grammar(), sentence), ParsedCommand)


def test_the_page_has_examples_for_every_part_of_a_task() -> None:
    assert len(SENTENCES) == 17


def test_the_picture_of_a_refusal_is_the_one_shown() -> None:
    sentence = "GRASP MACS-OLD HANDLE-A MANTAIN SPEED"
    refusal = parse(default_grammar(), sentence)
    assert isinstance(refusal, Refusal)
    assert show(sentence, refusal) in PAGE


def test_the_counts_of_the_pages_are_those_of_the_grammar() -> None:
    counts = dictionary.stats()
    for name in ("reserved_words", "token_classes", "clauses", "productions"):
        assert re.search(rf"\b{counts[name]} {name.replace('_', ' ')}", PAGE), name
    assert f"one of {len(dictionary.verbs())} words" in (ROOT / "README.md").read_text("utf-8")
