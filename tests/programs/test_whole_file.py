"""One file for several kinds of worker: its sections, in the order in which they fit."""

from __future__ import annotations

from pathlib import Path

import pytest

from rtc.programs import loader
from rtc.programs.whole_file import sections
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import ProgramError

WIPE = Path(__file__).parents[1] / "workers" / "wipe.yaml"


def load(text: bytes) -> dict[WorkerKind, bytes]:
    programs = {kind: loader.default(kind) for kind in WorkerKind}
    for kind, part in sections(text, "wipe.yaml").items():
        programs[kind] = loader.merge(kind, programs[kind], "wipe.yaml", part, programs)
    return programs


def test_a_whole_verb_is_one_file():
    programs = load(WIPE.read_bytes())
    assert b"wipe-gently" in programs[WorkerKind.ELABORATOR]
    assert b"%extend work: WIPE" in programs[WorkerKind.PARSER]
    assert load(b"elaborator: {settable: {wax: {unit: m, of: [wax], example: 1 MM}}}")  # in one line


def test_an_error_has_the_line_of_the_whole_file():
    text = WIPE.read_bytes().replace(b"stop: move_to_contact", b"stop: move_cleer", 1)
    line = 1 + text[: text.index(b"move_cleer")].count(b"\n")
    with pytest.raises(ProgramError, match=rf"wipe.yaml, line {line}: .*move_cleer"):
        load(text)


@pytest.mark.parametrize("text", [b"scripts: []", b"- a", b"", b"binder: {}\nplanner: {}", b"a: [", b"\xff: 1"])
def test_another_file_is_refused(text):
    with pytest.raises(ProgramError):
        sections(text, "x.yaml")
