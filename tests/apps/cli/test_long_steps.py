"""The question about a step that takes long: asked once, obeyed when answered, no hindrance when not."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator

import pytest

from rtc.apps.cli.long_steps import LongSteps
from rtc.protocol.messages import Phase, ProgressNote


class Terminal:
    """A pipe for the input; the printed lines and the halts."""

    def __init__(self) -> None:
        self.reads, self._writes = os.pipe()
        self.lines: list[str] = []
        self.halted: list[str] = []
        self.was_halted = threading.Event()
        self.steps = LongSteps(self.lines.append, self.halt, self.reads)

    def halt(self, command: str) -> None:
        self.halted.append(command)
        self.was_halted.set()

    def types(self, text: str) -> None:
        os.write(self._writes, text.encode())

    def takes(self, expected_s: float, phase: Phase = Phase.EXECUTING) -> None:
        self.steps.take(ProgressNote(seq=1, at_s=0.0, command="C-7", phase=phase, expected_s=expected_s))

    def close(self) -> None:
        self.steps.drop()
        os.close(self.reads)
        os.close(self._writes)


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    made = Terminal()
    yield made
    made.close()


def test_a_short_step_is_not_asked_about(terminal: Terminal) -> None:
    terminal.takes(59.0)
    assert terminal.lines == []


def test_a_long_step_is_asked_about_once(terminal: Terminal) -> None:
    terminal.takes(10_000.0)
    terminal.takes(10_000.0)
    assert terminal.lines == ["C-7: this step takes about 2 h 47 min: go on? [Y/n]  (n halts it)"]


@pytest.mark.parametrize("answer", ["n\n", "H\n", "no\n"])
def test_no_halts_the_command(terminal: Terminal, answer: str) -> None:
    terminal.takes(100.0)
    terminal.types(answer)

    assert terminal.was_halted.wait(5.0)
    assert terminal.halted == ["C-7"]


def test_what_is_typed_after_the_step_is_for_others(terminal: Terminal) -> None:
    terminal.takes(100.0)
    terminal.takes(0.0, Phase.ANALYZING)
    terminal.types("n\n")

    assert os.read(terminal.reads, 10) == b"n\n"
    assert terminal.halted == []
