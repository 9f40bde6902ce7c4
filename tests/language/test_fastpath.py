"""The plain halt: recognised without a grammar, exactly as the parser does."""

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rtc.language.fastpath import halt_scope
from rtc.language.parse import default_grammar, parse
from rtc.protocol.sentence import ParsedCommand

GRAMMAR = default_grammar()


@pytest.mark.parametrize(
    ("text", "scope"),
    [
        ("HALT", "ALL"),
        ("STOP", "ALL"),
        ("stop.", "ALL"),
        ("  Halt , all . -- now!", "ALL"),
        ("HALT\r\n", "ALL"),
        ("HALT LEFT-ARM", "LEFT-ARM"),
        ("halt right_arm", "RIGHT-ARM"),
        ("STOP LEFT-END-EFF", "LEFT-ARM"),
        ("STOP right_end_eff.", "RIGHT-ARM"),
        ("HALT BOTH-ARMS", "ALL"),
        ("HALT C-7", "C-7"),
        ("halt c_12.", "C-12"),
        ("HALT ARM GANTRY", "GANTRY"),
        ("stop arm crawler_2", "CRAWLER-2"),
    ],
)
def test_halts(text: str, scope: str) -> None:
    assert halt_scope(text) == scope


@pytest.mark.parametrize(
    "text",
    [
        *(
            "",
            " ",
            "XHALT",
            "HALT C-7X",
            "HAL",
            "HALT C7",
            "HALT DOOR-2",
            '"HALT"',
            "ＨＡＬＴ",
            "HALT ARM C-7",
        ),
        *("TEST HALT", "GRASP X UNLESS SLIP THEN STOP", "PAUSE", "-- HALT"),
    ],
)
def test_no_plain_halts(text: str) -> None:
    assert halt_scope(text) is None


@pytest.mark.parametrize(
    "text",
    [
        *("HALT NOW", "STOP!", "halt!!", "STOP THE ARM", "HALT RIGHT ARM", "stop right-arm now", "HALT ALL ARMS"),
        *("HALT RIGHT-ARM AND LEFT-ARM", "HALT HALT", "HALT ALL ALL", "HALT..", "HALT C-", "HALT C-7 C-8", "STOP, IT!"),
        *("HALT ARM", "HALT ARM LEFT-ARM", "HALT ARM ALL", "HALT ARM PARK"),
        *("HALT; STOP", "HALT\nHALT", "HALT\x00", "HALT" + " " * 2000, "HALT " + "x" * 100_000),
        *("HALTT", "HALT-", "HALT_ALL", "STOPP", "haltx", "HALT-RIGHT-ARM", "STOPALL", "HALTX RIGHT-ARM"),
    ],
)
def test_what_begins_like_a_halt_and_is_no_sentence_halts_everything(text: str) -> None:
    assert halt_scope(text) == "ALL"
    assert not isinstance(parse(GRAMMAR, text), ParsedCommand)


@pytest.mark.parametrize("text", [None, b"HALT", 7, ["HALT"]])
def test_what_is_no_text_is_no_halt(text: object) -> None:
    assert halt_scope(text) is None  # type: ignore[arg-type]


WORDS = ["HALT", "stop", "Stop", "TEST", "ALL", "all", "LEFT_ARM", "RIGHT-END-EFF", "BOTH-ARMS", "ARM", "GANTRY", "N"]
WORDS += ["C-7", "C-", "C-7-A", "PARK", "DOOR-2", ".", ",", "--", "\t", "\n", "\x07", "X"]


@given(st.lists(st.sampled_from(WORDS), max_size=5), st.sampled_from([" ", "", ", "]))
@settings(max_examples=400, deadline=None, derandomize=True)
@example(["HALT", "ARM", "N"], " ")
def test_a_plain_halt_is_the_same_halt_to_the_parser(words: list[str], between: str) -> None:
    text = between.join(words)
    scope = halt_scope(text)
    parsed = parse(GRAMMAR, text)
    is_halt = isinstance(parsed, ParsedCommand) and parsed.verb == "HALT" and not parsed.test
    if scope is not None and not is_halt:
        assert scope == "ALL"
        assert not isinstance(parsed, ParsedCommand)
    elif scope is not None:
        named = parsed.hand or parsed.object  # type: ignore[union-attr]
        assert scope == ("ALL" if named == "BOTH-ARMS" else named)
    elif is_halt:  # the parser knows more halts: of any named thing
        assert "DOOR-2" in text or "GANTRY" in text or "N" in text or "X" in text or "C-" in text


@given(st.text())
@settings(max_examples=200, derandomize=True)
def test_any_text_has_an_answer(text: str) -> None:
    scope = halt_scope(text)
    assert scope is None or text.strip()[:4].upper() in ("HALT", "STOP")
