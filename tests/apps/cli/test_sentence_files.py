"""Files of sentences: comments, labels, and files that cannot be read."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer

from rtc.apps.cli.sentence_files import read


def test_comments_and_blank_lines_are_left_out_and_labels_become_numbers(tmp_path: Path) -> None:
    file = tmp_path / "plan.txt"
    file.write_text("# Phase 1\n\nC12: STOW LEFT-ARM\n-- in parallel\n  MOVE RIGHT-ARM TO BAY-2-FRONT  \n")

    assert read(file) == [("C-12", "STOW LEFT-ARM"), ("", "MOVE RIGHT-ARM TO BAY-2-FRONT")]


def test_a_file_that_is_not_there_is_reported_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(typer.Exit) as left:
        read(tmp_path / "none.txt")

    assert left.value.exit_code == 2
    assert "cannot read" in capsys.readouterr().err
