"""What `rtc do` reads from a file."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer

from rtc.apps.cli.sentences import _lines, quotes_forgotten


def test_labels_comments_and_blank_lines_are_left_out(tmp_path: Path) -> None:
    file = tmp_path / "plan.txt"
    file.write_text("# Phase 1\n\nC12: STOW LEFT-ARM\n-- in parallel\n  MOVE RIGHT-ARM TO BAY-2-FRONT  \n")

    assert _lines(file) == ["STOW LEFT-ARM", "MOVE RIGHT-ARM TO BAY-2-FRONT"]


def test_a_file_that_is_not_there_is_reported_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(typer.Exit) as left:
        _lines(tmp_path / "none.txt")

    assert left.value.exit_code == 2
    assert "cannot read" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("texts", "kinds", "hinted"),
    [
        (["STOW", "RIGHT-ARM"], ["refused", "not_sent"], True),
        (["STOW", "RIGHT-ARM"], ["refused"], True),  # as with --no-wait
        (["HALT", "RIGHT-ARM"], ["succeeded", "refused"], True),
        (["STOW"], ["refused"], False),
        (["STOW LEFT-LEG", "HALT"], ["refused", "not_sent"], False),
        (["HALT", "HALT"], ["succeeded", "succeeded"], False),
    ],
)
def test_single_words_that_are_refused_may_be_a_sentence_without_its_quotes(
    texts: list[str], kinds: list[str], hinted: bool
) -> None:
    hint = quotes_forgotten(texts, [{"text": text, "kind": kind} for text, kind in zip(texts, kinds, strict=False)])

    assert hint.endswith(f'rtc do "{" ".join(texts)}"') if hinted else hint == ""
