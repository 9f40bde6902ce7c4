"""Programs of sentences: comments, labels that become numbers of commands, and files that are refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer

from rtc.apps.cli.sentence_files import Labels, SentenceLine, line_of, never_sent, read
from rtc.language.parse import default_grammar, parse
from rtc.protocol.sentence import ParsedCommand


def written(folder: Path, *lines: str) -> Path:
    file = folder / "plan.txt"
    file.write_text("\n".join(lines))
    return file


def test_comments_and_blank_lines_are_left_out_and_labels_have_one_spelling(tmp_path: Path) -> None:
    file = written(tmp_path, "# Phase 1", "", "C12: STOW LEFT-ARM", "-- in parallel", "  c_13:MOVE RIGHT-ARM TO P1  ")

    assert [(line.label, line.text) for line in read(file)] == [
        ("C-12", "STOW LEFT-ARM"),
        ("C-13", "MOVE RIGHT-ARM TO P1"),
    ]


@pytest.mark.parametrize(
    ("written", "text"),
    [
        ("STOW LEFT-ARM  # out of the way", "STOW LEFT-ARM"),
        ('SHOW "A # B" # state', 'SHOW "A # B"'),
        ("C1: STOW LEFT-ARM -- out of the way", "STOW LEFT-ARM -- out of the way"),  # a comment of the language
    ],
)
def test_a_comment_may_follow_a_sentence(written: str, text: str) -> None:
    line = line_of(written)
    assert line is not None
    assert line.text == text


def test_the_byte_order_mark_of_some_editors_is_no_part_of_the_first_sentence(tmp_path: Path) -> None:
    file = tmp_path / "plan.txt"
    file.write_bytes(b"\xef\xbb\xbfC1: STOW LEFT-ARM\r\n")
    assert [(line.label, line.text) for line in read(file)] == [("C-1", "STOW LEFT-ARM")]


def test_a_file_that_is_not_there_is_reported_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(typer.Exit) as left:
        read(tmp_path / "none.txt")

    assert left.value.exit_code == 2
    assert "cannot read" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("lines", "place"),
    [
        (["C1: STOW LEFT-ARM", "", "C3: STOW RIGHT-ARM AFTER C2"], "plan.txt:3"),
        (["STOW RIGHT-ARM AFTER C2"], "plan.txt:1"),  # never a number of the cluster
        (["STOW RIGHT-ARM AFTER C-9", "C9: STOW LEFT-ARM"], "plan.txt:1"),  # it comes later
        (["C1: STOW LEFT-ARM", "STOW RIGHT-ARM TOGETHER-WITH C-7"], "plan.txt:2"),
        (["C1: HOLD LEFT-ARM", "ABORT C-2"], "plan.txt:2"),
        (["C1: HOLD LEFT-ARM", "C-1: STOW LEFT-ARM"], "plan.txt:2"),
        (["C1:"], "plan.txt:1"),
    ],
)
def test_a_label_that_is_unknown_doubled_or_empty_is_refused_with_its_line(
    lines: list[str], place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(typer.Exit) as left:
        read(written(tmp_path, *lines))

    assert left.value.exit_code == 2
    assert place in capsys.readouterr().err


@pytest.mark.parametrize(
    "lines",
    [
        ["STOW RIGHT-ARM AFTER C-9"],  # without labels: a number of the cluster
        ["C1: STOW LEFT-ARM", "STOW RIGHT-ARM AFTER LAST"],
        ["C1: HOLD LEFT-ARM", "STOW RIGHT-ARM AFTER C1 -- not AFTER C2", "PAUSE c-1"],
        ["C1: HOLD LEFT-ARM", "HALT ALL", "ABORT"],
    ],
)
def test_a_program_whose_labels_are_all_known_is_read(lines: list[str], tmp_path: Path) -> None:
    assert len(read(written(tmp_path, *lines))) == len(lines)


@pytest.mark.parametrize("file", sorted((Path(__file__).parents[3] / "docs" / "tutorial").glob("*.txt")), ids=str)
def test_the_programs_of_the_tutorial_are_read(file: Path) -> None:
    """tests/processes/test_pages.py runs them."""
    own_words = {"status", "why"}  # of the shell
    sentences = [line.text.rstrip("&") for line in read(file) if line.text not in own_words]

    assert sentences
    assert all(isinstance(parse(default_grammar(), text), ParsedCommand) for text in sentences)


def test_labels_are_sent_as_the_numbers_of_their_commands() -> None:
    labels = Labels()
    labels.numbers |= {"C-3": "C-31", "C-4": "C-32", "B-1": "C-33"}

    assert labels.sent_as("STOW LEFT-ARM AFTER C3") == "STOW LEFT-ARM AFTER C-31"
    assert labels.sent_as("stow left_arm together_with c-4 NOW") == "stow left_arm together_with C-32 NOW"
    assert labels.sent_as("ABORT B1 -- as AFTER C3") == "ABORT C-33 -- as AFTER C3"
    assert labels.sent_as('CANNOT "it is AFTER C3"') == 'CANNOT "it is AFTER C3"'
    assert labels.sent_as("GRASP C3 WITH LEFT-ARM") == "GRASP C3 WITH LEFT-ARM"  # an object
    assert labels.sent_as("STOW LEFT-ARM AFTER C-9") == "STOW LEFT-ARM AFTER C-9"


def test_a_label_without_a_command_never_becomes_a_number_of_the_cluster() -> None:
    labels = Labels([SentenceLine("C-3", "HALT")])
    assert not labels.known("STOW LEFT-ARM AFTER C-3")
    assert labels.known("HALT C-7")  # a number of the cluster: a halt must not wait
    labels.numbers["C-3"] = ""

    assert labels.known("STOW LEFT-ARM AFTER C-3")
    assert labels.sent_as("STOW LEFT-ARM AFTER C-3") == "STOW LEFT-ARM AFTER C3"


@pytest.mark.parametrize("text", ["", "   ", "# C3: STOW LEFT-ARM", "-- a comment"])
def test_lines_without_a_sentence(text: str) -> None:
    assert line_of(text) is None


GIVE = "GIVE RIGHT-ARM TO OPERATOR"


@pytest.mark.parametrize(
    ("texts", "named"),
    [
        ([GIVE, "STOW RIGHT-ARM"], []),
        ([GIVE, "STOW LEFT-ARM", "take RIGHT-ARM FROM OPERATOR"], ["take RIGHT-ARM FROM OPERATOR", GIVE]),
        ([GIVE, "DONE"], ["DONE", GIVE]),
        (["DONE", GIVE], []),
    ],
)
def test_a_line_that_another_one_waits_for_is_found_before_anything_is_sent(texts: list[str], named: list[str]) -> None:
    problem = never_sent([SentenceLine("", text) for text in texts])
    assert bool(problem) == bool(named)
    assert all(text in problem for text in named)  # wording: it names both lines
