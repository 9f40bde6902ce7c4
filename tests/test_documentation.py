"""The documents explain what the code cites, and name packages and files that exist."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from rtc.apps.cli.main import build
from rtc.language.parse import default_grammar, parse
from rtc.protocol.outcomes import Refusal
from tests import decisions_page, mechanisms_page

ROOT = Path(__file__).parents[1]
PACKAGES = ("rtc", "broker", "workers", "sim_mcm", "deploy")
CITING = {".py", ".md", ".yaml", ".lark", ".toml"}
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "benchmarks").glob("*.md")])


def texts() -> list[Path]:
    places = [ROOT / name for name in (*PACKAGES, "tests", "benchmarks", "docs")]
    found = [p for place in places for p in place.rglob("*") if p.suffix in CITING and p != Path(__file__)]
    return found + [p for p in ROOT.glob("*") if p.suffix in CITING]


def marks(text: str) -> set[str]:
    """R and A marks in a text; a range such as R60-R67 counts in full."""
    found = set(re.findall(r"\b[RA][1-9]\d{0,2}\b", text))
    for letter, first, last in re.findall(r"\b([RA])([1-9]\d*)-[RA]([1-9]\d*)\b", text):
        found |= {f"{letter}{number}" for number in range(int(first), int(last) + 1)}
    return found


def rows(page: str) -> set[str]:
    return set(re.findall(r"^\| ([RA]\d+) \|", (ROOT / page).read_text(), re.MULTILINE))


def test_each_cited_mark_is_explained():
    explained = rows("docs/requirements.md")
    missing = {f"{p.relative_to(ROOT)}: {m}" for p in texts() for m in marks(p.read_text()) - explained}
    assert not missing


def test_no_line_number_of_the_paper_is_cited():
    wrong = {str(p.relative_to(ROOT)) for p in texts() if re.search(r"\bL\d{2,3}(-\d+)?\)|\(L\d{2,3}\b", p.read_text())}
    assert not wrong


def test_each_cited_invariant_is_in_the_architecture():
    section = (ROOT / "ARCHITECTURE.md").read_text().partition("## What must always hold")[2].partition("\n## ")[0]
    numbered = set(re.findall(r"^(\d+)\. ", section, re.MULTILINE))
    assert numbered
    cited = {(p.name, n) for p in texts() for n in re.findall(r"\binvariants? (\d+)\b", p.read_text(), re.IGNORECASE)}
    assert {(name, n) for name, n in cited if n not in numbered} == set()


def test_the_architecture_names_functions_of_their_files():
    page = (ROOT / "ARCHITECTURE.md").read_text()
    named = [
        (f, n) for f, names in re.findall(r"`([\w/]+\.py)` \(([^)]*)\)", page) for n in re.findall(r"`(\w+)`", names)
    ]
    assert named
    wrong = [
        each
        for each in named
        if not re.search(
            rf"\b(def {each[1]}\b|class {each[1]}\b|^{each[1]}\b)", (ROOT / each[0]).read_text(), re.MULTILINE
        )
    ]
    assert wrong == []


def test_a_page_names_files_that_exist():
    path = re.compile(r"`((?:rtc|broker|workers|sim_mcm|deploy|tests|benchmarks|docs)/[\w./-]*)`")
    named = {(page.name, name) for page in PAGES for name in path.findall(page.read_text())}
    assert [row for row in named if "NAME" not in row[1] and not (ROOT / row[1]).exists()] == []


def test_lines_of_a_page_are_short():
    """Long lines make a diff unreadable. Tables, code blocks and links cannot be broken."""
    assert [f"{page.name}:{number}" for page in PAGES for number in long_lines(page)] == []


def long_lines(page: Path) -> Iterator[int]:
    code = False
    for number, line in enumerate(page.read_text().splitlines(), 1):
        code ^= line.startswith("```")
        if len(line) > 120 and not code and not line.startswith(("|", "[", "!")):
            yield number


def shown_commands() -> list[tuple[str, ...]]:
    """The words of each `rtc` command line in a code block of a page, without comments and `&`."""
    blocks = [b for p in PAGES for b in re.findall(r"^```\n(.*?)^```", p.read_text(), re.MULTILINE | re.DOTALL)]
    lines = [line for block in blocks for line in block.splitlines() if line.startswith("rtc ")]
    typed = [re.sub(r"\$\(.*?\)", "docs", line).partition(" & ")[0].partition(" < ")[0] for line in lines]
    words = [shlex.split(line, comments=True)[1:] for line in typed]
    return sorted({tuple(each) for each in words})


def parse_options(command: Any, words: list[str], parent: Any = None) -> None:
    """Raise a usage error for an unknown subcommand, option or argument. Nothing is executed."""
    context = command.make_context(command.name, words, parent=parent)
    if hasattr(command, "resolve_command"):
        _, subcommand, rest = command.resolve_command(context, [*context._protected_args, *context.args])
        parse_options(subcommand, rest, context)


@pytest.mark.parametrize("words", shown_commands(), ids=" ".join)
def test_a_command_line_of_a_page_is_valid(words: tuple[str, ...]):
    parse_options(typer.main.get_command(build([words[0]])), list(words))
    if words[0] in ("do", "parse"):
        for sentence in (word for word in words[1:] if " " in word):
            wrong = isinstance(parse(default_grammar(), sentence), Refusal)
            assert wrong is sentence.startswith("GRAPS")


def test_each_decision_has_a_number_of_its_own():
    numbers = Counter(page.name.partition("-")[0] for page in (ROOT / "docs" / "decisions").glob("[0-9]*.md"))
    assert [number for number, count in numbers.items() if count > 1] == []


def test_the_list_of_decisions_is_up_to_date():
    written = (decisions_page.FOLDER / "README.md").read_text()
    assert written == decisions_page.page(), "write it anew: python -m tests.decisions_page > docs/decisions/README.md"


def test_the_page_of_mechanisms_is_up_to_date():
    written = (ROOT / "docs" / "mechanisms.md").read_text()
    assert written == mechanisms_page.page(), "write it anew: python -m tests.mechanisms_page > docs/mechanisms.md"


def test_the_list_for_language_models_names_pages_that_exist():
    named = re.findall(r"\]\((\S+)\)", (ROOT / "docs" / "llms.txt").read_text())
    assert named
    assert [name for name in named if not (ROOT / name).is_file()] == []
