"""The grammar of the parser and the grammar of the dictionary are one; a bad grammar is refused with its fault."""

import re
from collections import Counter
from importlib import resources

import pytest

from rtc.language import dictionary
from rtc.language.grammar import Grammar
from rtc.language.parse import default_grammar, parse
from rtc.language.words import TOKEN_CLASSES
from rtc.protocol.outcomes import ProgramError, Refusal
from rtc.protocol.sentence import ParsedCommand

TEXT = resources.files("rtc.language").joinpath("command.lark").read_text()


def spelt(word: str, spelling: str) -> str:
    """The grammar with another spelling of a reserved word."""
    return re.sub(rf"(%declare .*)\b{word}\b", r"\1", TEXT) + f"\n{word}: {spelling}\n"


def test_the_parser_has_the_productions_of_the_dictionary() -> None:
    known = Counter(
        (clause, tuple(symbol.strip("<>").upper() if "<" in symbol else symbol for symbol in production))
        for clause, productions in dictionary.clauses().items()
        for production in productions
    )
    assert Counter(default_grammar().productions) == known


def test_the_parser_has_the_terminals_of_the_dictionary() -> None:
    grammar = default_grammar()
    reserved = {word for _, word in grammar.vocabulary.reserved.values()}
    synonyms = {word for words in dictionary.synonyms().values() for word in words}

    assert len(reserved) == dictionary.stats()["reserved_words"]
    assert set(grammar.vocabulary.reserved) == reserved | synonyms == dictionary.reserved_words()
    assert len(TOKEN_CLASSES) == dictionary.stats()["token_classes"]


def test_no_reserved_word_is_a_name() -> None:
    grammar = default_grammar()
    for word in grammar.vocabulary.reserved:
        assert isinstance(parse(grammar, f"LOCATE {word}"), Refusal), word
        assert isinstance(parse(grammar, f"LOCATE {word}-1"), ParsedCommand), word


def test_a_grammar_with_a_new_verb_is_only_another_text() -> None:
    text = TEXT.replace("handle: ", "handle: WIPE NAME amount with maintain reflex -> command\n      | ", 1)
    grammar = Grammar(text + '\nWIPE: "WIPE" | "POLISH"\n')

    parsed = parse(grammar, "polish PANEL-1 BY 3 TURNS WITH LEFT-ARM GUARDED")

    assert isinstance(parsed, ParsedCommand)
    assert (parsed.verb, parsed.object, parsed.hand, parsed.guarded) == ("WIPE", "PANEL-1", "LEFT-ARM", True)
    assert isinstance(parse(default_grammar(), "POLISH PANEL-1"), Refusal)


def test_two_grammars_do_not_disturb_each_other() -> None:
    other = Grammar(spelt("LIFT", '"HOIST"'))
    for _ in range(2):
        assert isinstance(parse(default_grammar(), "LIFT X"), ParsedCommand)
        assert isinstance(parse(other, "HOIST X"), ParsedCommand)
        assert isinstance(parse(other, "LIFT X"), Refusal)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "does not compile"),
        ("sentence: ", "clause sentence"),
        (TEXT.replace("task: grasp", "task: grapple"), "grapple"),
        (TEXT.replace("task: grasp", "task: work | grasp"), "does not compile"),  # two ways to read OPEN
        (TEXT.replace("-> handoff", "-> handover"), "handover"),
        (TEXT.replace("-> handoff", ""), "carry"),
        (spelt("GRASP", '"Grasp it"'), "capitals"),
        (TEXT.replace("LIFT NAME", "LIFTT NAME"), "LIFTT"),
        ('sentence: HALT -> command\nHALT: "HALT"\n', "token class NAME"),
        ("%import nowhere.X\nsentence: X -> command\n", "must not use %import"),
        ("(" * 3000, "does not compile"),
    ],
)
def test_a_bad_grammar_is_refused_with_its_fault(text: str, fault: str) -> None:
    with pytest.raises(ProgramError, match=fault):
        Grammar(text)
