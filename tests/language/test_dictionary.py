"""The dictionary: complete, counted, and in the notation of the paper's Figure 2."""

import re

import pytest

from rtc.language import dictionary
from rtc.language.parse import default_grammar, parse
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.sentence import ParsedCommand


def entry(verb: str) -> str:
    text = dictionary.entry(verb)
    assert isinstance(text, str)
    return text


def test_stats() -> None:
    assert dictionary.stats() == {
        "terminals": 113,
        "reserved_words": 109,
        "token_classes": 4,
        "clauses": 56,
        "productions": 175,
        "synonyms": 5,
    }


def test_the_entry_of_halt() -> None:
    assert entry("HALT") == (
        "HALT: stop motion now\n"
        "\n"
        "  example    HALT\n"
        "             HALT RIGHT-ARM\n"
        "             HALT C-7\n"
        "\n"
        "sentence --> HALT scope\n"
        "scope --> nil\n"
        "      --> ALL\n"
        "      --> thing\n"
        "thing --> hand\n"
        "      --> <name>\n"
        "hand --> end-effector\n"
        "     --> LEFT-ARM\n"
        "     --> RIGHT-ARM\n"
        "     --> BOTH-ARMS\n"
        "     --> ARM <name>\n"
        "end-effector --> LEFT-END-EFF\n"
        "             --> RIGHT-END-EFF\n"
    )


def test_the_entry_of_grasp_has_the_clauses_of_figure_2_in_its_order() -> None:
    lines = entry("grasp").splitlines()
    figure = [
        "grasp --> GRASP goal maintain reflex",
        "goal --> end-effector <name> grasp-point",
        "end-effector --> LEFT-END-EFF",
        "             --> RIGHT-END-EFF",
        "maintain --> nil",
        "reflex --> GUARDED reflex-items",
        "reflex-items --> nil",
        "             --> reflex-item reflex-items",
        "reflex-item --> UNLESS condition THEN action",
    ]
    assert [line for line in lines if line in figure] == figure


@pytest.mark.parametrize("verb", dictionary.verbs())
def test_an_entry_defines_every_clause_it_uses(verb: str) -> None:
    lines = [line for line in entry(verb).splitlines() if "-->" in line]
    defined = {line.split("-->")[0].strip() for line in lines} - {""}
    used = {s for line in lines for s in line.split("-->")[1].split() if s in dictionary.clauses()}

    assert used - {"sentence"} <= defined  # TEST takes any sentence: that is the whole grammar


def test_every_word_clause_and_task_verb_has_a_meaning() -> None:
    meanings = dictionary.meanings()
    synonyms = {word for words in dictionary.synonyms().values() for word in words}
    tasks = {p[0] for name in ("grasp", "move", "handle", "work", "carry", "look") for p in dictionary.clauses()[name]}

    assert set(meanings.words) == dictionary.reserved_words() - synonyms
    assert set(meanings.clauses) == set(dictionary.clauses())
    assert set(meanings.verbs) == tasks | {p[0] for p in dictionary.clauses()["data"]}


def test_every_verb_has_examples_that_are_sentences() -> None:
    examples = dictionary.meanings().examples
    grammar = default_grammar()

    assert set(examples) == set(dictionary.verbs())
    for verb, sentences in examples.items():
        assert all(f" {sentence}\n" in entry(verb) for sentence in sentences)
        for sentence in sentences:
            parsed = parse(grammar, sentence)
            assert isinstance(parsed, ParsedCommand), sentence
            assert sentence.split()[0] == verb


def test_a_synonym_has_the_entry_of_its_verb() -> None:
    assert entry("ungrasp") == entry("RELEASE")
    assert entry("RELEASE").startswith("RELEASE (also UNGRASP): ")


def test_a_verb_with_two_ways_shows_both() -> None:
    assert "OPEN a hand\n  class      Action 1\n" in entry("OPEN")
    assert "OPEN a held door\n  class      Skill 4\n" in entry("OPEN")


def test_an_unknown_verb_is_refused_with_the_nearest() -> None:
    refusal = dictionary.entry("graps")
    assert isinstance(refusal, Refusal)
    assert refusal.reason is RefusalReason.NAME
    assert refusal.nearest == ["GRASP"]
    assert refusal.expected == dictionary.verbs()


def test_the_parts_that_can_be_shared_can_be_written():
    parts = re.findall(r"\b[A-Z][A-Z-]+\b", dictionary.meanings().clauses["shared"])
    assert parts
    for part in parts:
        assert isinstance(parse(default_grammar(), f"STOW LEFT-ARM MAINTAIN SHARED {part}"), ParsedCommand)
