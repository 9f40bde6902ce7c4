"""The picture of a refused sentence, whole."""

from rtc.language.caret import WIDTH, show
from rtc.language.parse import default_grammar, parse
from rtc.protocol.outcomes import Refusal, RefusalReason

GRAMMAR = default_grammar()


def picture(sentence: str | bytes) -> str:
    refusal = parse(GRAMMAR, sentence)
    assert isinstance(refusal, Refusal)
    return show(sentence, refusal)


def test_a_long_list_is_only_named() -> None:
    refusal = Refusal(
        reason=RefusalReason.SENTENCE,
        message="GRAPS is not a verb.",
        column=0,
        expected=[f"V{n}" for n in range(37)],
        nearest=["GRASP"],
    )

    assert "V5" not in show("GRAPS X", refusal)
    assert "nearest: GRASP" in show("GRAPS X", refusal)
    assert "expected: one of 37 words; `rtc dictionary` lists the verbs" in show("GRAPS X", refusal)


def test_a_misspelt_word() -> None:
    assert picture("GRASP MACS-OLD HANDLE-A MANTAIN SPEED") == (
        "  GRASP MACS-OLD HANDLE-A MANTAIN SPEED\n"
        "                          ^\n"
        "MANTAIN cannot stand here, after HANDLE-A.\n"
        "expected: AFTER, GUARDED, MAINTAIN, NOW, REPORT, TOGETHER-WITH, UNLESS, VIA, WITH,\n"
        "          the end of the sentence\n"
        "nearest: MAINTAIN"
    )


def test_a_sentence_that_ends_too_early() -> None:
    assert picture("move Right_arm to") == (
        "  move Right_arm to\n"
        "                   ^\n"
        "The sentence ends too early, after TO.\n"
        "expected: a name, JOINTS, POSITION"
    )


def test_an_empty_sentence() -> None:
    assert picture("").splitlines()[:3] == ["", "  ^", "There is no command in this sentence."]


def test_characters_without_a_shape_are_made_visible_and_keep_their_column() -> None:
    assert picture("GRASP\tX\x1b[31m\u200b") == (
        "  GRASP X␛[31m�\n         ^\nThe invisible character U+001B is not printable text.\nexpected: readable text"
    )


def test_bytes_that_are_no_text() -> None:
    assert picture("é ".encode() + b"\xff GRASP") == (
        "  é � GRASP\n    ^\nThe byte 0xFF here is not UTF-8 text.\nexpected: readable text in UTF-8"
    )


def test_a_long_line_is_cut_on_both_sides_of_the_caret() -> None:
    sentence = "MOVE LEFT-ARM TO P " + "THROUGH Q " * 30 + "THRUOGH Q " + "THROUGH Q " * 30
    line, caret, message, *_ = picture(sentence).splitlines()

    assert len(line) <= WIDTH
    assert line.startswith("  ...")
    assert line.endswith("...")
    assert line[caret.index("^") :].startswith("THRUOGH")
    assert message == "THRUOGH cannot stand here, after Q."


def test_a_sentence_that_is_too_long_is_shown_at_the_limit() -> None:
    line, caret, *_ = picture("HALT" + " " * 1996 + "NOW").splitlines()
    assert line == "  ..." + " " * (len(line) - 8) + "NOW"
    assert line[caret.index("^") :] == "NOW"


def test_a_long_list_of_expected_words_is_wrapped_between_words() -> None:
    lines = picture("MOVE LEFT-ARM BY 5 CM QQQQ").splitlines()
    assert max(map(len, lines)) <= WIDTH
    words = " ".join(line.removeprefix("expected:").strip() for line in lines[3:]).split(", ")
    assert len(words) == 13
    assert (words[0], len(lines)) == ("AFTER", 5)


def test_a_refusal_without_a_place_has_no_caret() -> None:
    refusal = Refusal(reason=RefusalReason.NAME, message="No such verb.", nearest=["GRASP"])
    assert show("GRAPS", refusal) == "No such verb.\nnearest: GRASP"
