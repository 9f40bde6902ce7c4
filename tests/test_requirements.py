"""The page of requirements: each one once, with tests and commands that exist; counts and figures are the true ones."""

from __future__ import annotations

import ast
import json
import re
import shlex
from functools import cache
from pathlib import Path

import pytest
import typer

from rtc.apps.cli.main import build
from rtc.language import dictionary
from tests.test_documentation import PAGES, parse_options

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "requirements.md"


def table(heading: str) -> list[list[str]]:
    """The cells of each row of the first table under a heading, without its two head lines."""
    section = PAGE.read_text().partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def named(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def test_every_requirement_has_one_row():
    assert [row[0] for row in table("Requirements")] == [f"R{number}" for number in range(1, 153)]


def test_a_requirement_is_shown_or_not_yet():
    for mark, section, text, shown, missing in table("Requirements"):
        assert section, mark
        assert text, mark
        if shown == "not yet":
            assert missing, mark
        else:
            assert named(shown), mark
            assert [name for name in named(shown) if not exists(name)] == [], mark


def exists(name: str) -> bool:
    """Whether a test, a command of `rtc`, a module to run or a target of make exists."""
    if "::" in name:
        path, _, function = name.partition("::")
        return (ROOT / path).is_file() and function in functions(ROOT / path)
    words = shlex.split(name)
    if words[0] == "rtc":
        parse_options(typer.main.get_command(build([words[1]])), words[1:])
        return True
    if words[:2] == ["python", "-m"]:
        module = ROOT.joinpath(*words[2].split("."))
        return (module / "__main__.py").is_file() or "__main__" in module.with_suffix(".py").read_text()
    return words[0] == "make" and re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(), re.MULTILINE) is not None


@cache
def functions(path: Path) -> set[str]:
    return {node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}


def test_the_page_counts_its_rows():
    shown = [row for row in table("Requirements") if row[3] != "not yet"]
    whole = [row for row in shown if not row[4]]
    counts = (len(whole), len(shown) - len(whole), 152 - len(shown))
    stated = re.search(r"(\d+) are shown, (\d+) in part, (\d+) not yet", PAGE.read_text())
    assert stated
    assert tuple(int(each) for each in stated.groups()) == counts


@pytest.mark.parametrize("row", table("Horizons"), ids=lambda row: row[0])
def test_each_level_keeps_its_declared_horizon(row: list[str]):
    _level, _what, horizon, measured, result = row
    if measured.startswith("not yet"):
        assert not result
        return
    name, metric = named(result)
    value, unit = measured.split(" ")
    newest = json.loads((ROOT / "benchmarks" / "results" / f"{name}.json").read_text())["metrics"][metric]
    assert float(value) == pytest.approx(newest, rel=0.01), "the newest result differs from the page"
    (limit,) = re.findall(rf"([\d.]+) {unit}", horizon)
    assert newest <= float(limit)


def test_counts_in_documents_are_those_of_the_grammar():
    counts = {name.replace("_", " "): count for name, count in dictionary.stats().items()}
    kinds = "|".join(counts)
    stated = [
        (page.name, kind, int(number))
        for page in PAGES
        for number, kind in re.findall(rf"(\d+)\s+({kinds})\b", page.read_text())
    ]
    assert stated
    assert [each for each in stated if counts[each[1]] != each[2]] == []
