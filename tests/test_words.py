"""Words of the project, tested: retired words, module docstrings and the length of their first sentence.

A word is a run of letters; `snake_case` and `CamelCase` names are split, so that identifiers are searched like prose.
An entry with `_` is retired as a part of an identifier only.
In Python files everything is searched, in Markdown the text, in YAML the comments: the keys are part of the language.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.source_files import ROOT, place, source

FOLDERS = ("rtc", "broker", "workers", "sim_mcm", "deploy", "tests", "benchmarks", "docs")
FIRST_SENTENCE = 25  # words, maximum

#: retired word, words in sequence, or words of one identifier -> the word that the project uses
RETIRED = {
    "as_a_callers": "sanitize_halt",
    "fold": "merge",
    "front door": "connection of the client",
    "gate": "gateway",
    "give_out": "assign (a job), create (a job)",
    "he": "the operator",
    "hear": "receive, handle",
    "heard": "received, handled",
    "hearing": "receiving, handling",
    "hears": "receives, handles",
    "him": "the operator",
    "his": "of the operator",
    "knock": "connect",
    "legs": "path segments",
    "lifeline": "heartbeat",
    "nobody": "no process, no client, no one",
    "outlet": "output stream",
    "patience": "timeout_scale",
    "pools": "autoscaler",
    "roster": "worker registry",
    "said": "sent, stated, submitted",
    "said_in_sentence": "from_command",
    "shadows": "fences",
    "situation": "task candidate",
    "somebody": "a process, a client, someone",
    "starting_points": "anchors",
    "surroundings": "environment",
    "telling": "stating, reporting",
    "told": "reported, stated, commanded",
    "twin": "standby",
    "unheard": "OutputClosed",
    "untold": "deferred analysis",
    "whoever": "the client that, each process that",
}
#: retired names of types -> the name that the project uses
RETIRED_TYPES = {
    "Belief": "WorldQuery",
    "Ending": "PendingOutcome",
    "Fold": "HaltRateLimiter",
    "FrontDoor": "BrokerConnection",
    "Guard": "MemoryGuard",
    "Memory": "StateFile",
    "Setting": "PlanningRequest",
    "Situation": "TaskCandidate",
    "Start": "Anchor",
    "Turn": "DecisionContext",
}
#: retired names of modules
RETIRED_MODULES = {
    "belief", "doors", "front_door", "gate", "hardware", "legs", "lifeline", "naming", "outlet", "pools", "program_fit",
    "program_place", "registered", "roster", "silence", "situation", "starting_points", "telling", "untold",
    "warm",
}  # fmt: skip
#: (word, place, text in the line): the uses that stay, each with its reason
ALLOWED: tuple[tuple[str, str, str], ...] = (
    # The process `gate`: its name in status, counters, logs and halt calls is part of the wire.
    ("gate", "", '"gate"'),
    ("gate", "broker/", "gate_"),
    ("gate", "broker/gateway/halt_forwarding.py", 'f"gate {'),
    ("gate", "docs/security.md", "dropped_gate_strangers"),
    ("gate", "", "logs/gate.log"),
    ("gate", "tests/processes/test_gateway.py", "dropped_gate_"),
    ("gate", "tests/broker/gateway/test_refusals.py", "gate_stale"),
    ("his", "CHANGELOG.md", "`his`"),
    # A parameter of the library rich.
    ("fold", "rtc/apps/cli/output.py", 'overflow="fold"'),
)

WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
IDENTIFIER = re.compile(r"[A-Za-z_]+")
NO_LETTERS = re.compile(r"[^a-z]+")
PERHAPS = re.compile("|".join(NO_LETTERS.sub("", word) for word in RETIRED))  # in a line without other characters


@functools.cache
def files(*endings: str) -> list[Path]:
    found = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.suffix in endings]
    found += [path for path in ROOT.glob("*") if path.suffix in endings]
    return sorted(path for path in found if "__pycache__" not in path.parts and "results" not in path.parts)


def lines(path: Path) -> Iterator[tuple[int, str]]:
    """(number, text) of the lines to search."""
    for number, line in enumerate(path.read_text().splitlines(), 1):
        if path.suffix in (".yaml", ".yml"):
            _, _, line = f" {line}".partition(" #")
        yield number, line


def retired_in(line: str) -> list[str]:
    if not PERHAPS.search(NO_LETTERS.sub("", line.lower())):  # most lines: this is quicker
        return []
    prose = f" {' '.join(WORD.findall(line))} ".lower()
    names = " ".join(f"_{'_'.join(WORD.findall(name))}_" for name in IDENTIFIER.findall(line)).lower()
    return [word for word in RETIRED if (f"_{word}_" in names if "_" in word else f" {word} " in prose)]


def allowed(word: str, where: str, line: str) -> bool:
    return any(word == w and where.startswith(p) and text in line for w, p, text in ALLOWED)


@functools.cache
def uses() -> list[tuple[str, int, str, str]]:
    """(file, line number, line, retired word), but for this file, which lists them."""
    return [
        (place(path), number, line, word)
        for path in files(".py", ".md", ".yaml", ".yml")
        if path != Path(__file__)
        for number, line in lines(path)
        for word in retired_in(line)
    ]


def test_no_retired_word_is_used() -> None:
    found = [
        f"{where}:{number}: {word!r}, use: {RETIRED[word]}"
        for where, number, line, word in uses()
        if not allowed(word, where, line)
    ]
    assert not found, "\n".join(found)


def test_no_retired_name_of_a_module_or_type_is_used() -> None:
    assert [place(path) for path in files(".py") if path.stem.removeprefix("test_") in RETIRED_MODULES] == []
    types = {place(path): source(path).classes & RETIRED_TYPES.keys() for path in files(".py")}
    assert [row for row in types.items() if row[1]] == []


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("self._lifeline = None", ["lifeline"]),
        ("class Lifeline:", ["lifeline"]),
        ("def as_a_callers(scope):", ["as_a_callers"]),
        ("class StartingPoints:", ["starting_points"]),
        ("plan from the starting points", []),
        ("the lifelines of trees", []),
    ],
)
def test_a_retired_word_is_found_in_names_and_in_prose(line: str, found: list[str]) -> None:
    assert retired_in(line) == found


def test_every_allowed_use_is_still_there() -> None:
    """An entry that allows nothing any more is removed."""
    used = {
        entry
        for where, _, line, word in uses()
        for entry in ALLOWED
        if entry[0] == word and where.startswith(entry[1]) and entry[2] in line
    }
    assert not set(ALLOWED) - used


def test_a_module_says_in_one_short_sentence_what_it_is() -> None:
    first = {place(path): first_sentence(source(path).docstring) for path in files(".py")}
    assert [where for where, sentence in first.items() if not sentence] == [], "no docstring at the top"
    assert [row for row in first.items() if len(row[1].split()) > FIRST_SENTENCE] == []


def first_sentence(docstring: str) -> str:
    return re.split(r"(?<=[.!?])\s|\n\n", docstring.strip(), maxsplit=1)[0]


def test_a_sentence_ends_at_a_full_stop_or_a_blank_line() -> None:
    assert first_sentence("What `rtc.client` is. More.") == "What `rtc.client` is."
    assert first_sentence("Without a full stop\n\nMore") == "Without a full stop"
