"""The page `docs/own-arm.md`: its commands are typed as they stand."""

from __future__ import annotations

import json
import re
import shlex
import sys
from pathlib import Path

import pytest

from rtc.apps.cli import main
from rtc.language.parse import default_grammar, parse
from rtc.model.cells.cell import CELLS
from rtc.protocol.sentence import ParsedCommand
from tests.apps.authoring.conftest import DATA

PAGE = Path(__file__).parents[3] / "docs" / "own-arm.md"
LINES = [line for block in re.findall(r"```\n(.*?)```", PAGE.read_text(), re.DOTALL) for line in block.splitlines()]


@pytest.fixture
def compared_here() -> None:
    """In the process of the readers instead, as users have it."""


def run(line: str, monkeypatch: pytest.MonkeyPatch) -> int:
    words = [word.replace("$DATA", str(DATA)) for word in shlex.split(line)]
    monkeypatch.setattr(sys, "argv", words)
    try:
        main.main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_the_commands_of_a_first_cell_work(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    cells = [line for line in LINES if (line.startswith("rtc cell") and "PANDA" in line) or "panda" in line]
    commands = [line.partition(" -o ")[0] for line in cells if line.startswith("rtc cell")]
    assert len(commands) == 3
    for command in commands:
        assert run(command, monkeypatch) == 0, capsys.readouterr()
    assert "panda/cell.yaml: 0 errors, 0 warnings" in capsys.readouterr().out
    assert run(commands[1], monkeypatch) == 2  # it does not overwrite a cell
    assert "--force" in capsys.readouterr().err


def test_faults_end_the_check_with_status_one(tmp_path, monkeypatch, capsys) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text("name: mine\narms: []\nlights: 2\n")
    assert run(f"rtc cell check {file} --json", monkeypatch) == 1
    found = json.loads(capsys.readouterr().out)
    assert {row["where"] for row in found["findings"]} == {"$.lights"}
    assert found["errors"] == 1


@pytest.mark.physics
def test_an_arm_is_drawn_from_its_urdf_and_faults_are_named_instead(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("rtc cell check $DATA/kuka_iiwa/model.urdf -o arm.png", monkeypatch) == 0
    assert "picture: arm.png" in capsys.readouterr().out
    assert (tmp_path / "arm.png").read_bytes().startswith(b"\x89PNG")
    Path("broken.urdf").write_text("<robot name='x'><link name='a'>")
    assert run("rtc cell check broken.urdf -o broken.png", monkeypatch) == 1
    assert "no picture" in capsys.readouterr().out
    assert not Path("broken.png").exists()


def test_every_sentence_of_the_page_is_one() -> None:
    sentences = [text for line in LINES for text in re.findall(r'"([A-Z].*?)"', line)]
    sentences += re.findall(r"`(MOVE .*?)`", PAGE.read_text())
    assert len(sentences) >= 6
    for sentence in sentences:
        assert isinstance(parse(default_grammar(), sentence), ParsedCommand), sentence


def test_the_page_names_the_cells_of_the_project() -> None:
    for cell in CELLS.glob("*/cell.yaml"):
        assert f"`{cell.parent.name}`" in PAGE.read_text()
