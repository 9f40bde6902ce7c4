"""The sentences of one `rtc do` on their way to the cluster: labels become numbers of commands."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial

from rtc.apps.cli.progress import Board
from rtc.apps.cli.sentence_files import Labels, SentenceLine
from rtc.client.client import Client
from rtc.client.core import ANSWER_S
from rtc.client.rehearsing import AboutTest, is_test
from rtc.protocol import messages as m
from rtc.protocol.outcomes import TimedOut


class SentenceProgram:
    """The sentences of one `rtc do`, sent with the numbers of commands in place of labels."""

    def __init__(self, rtc: Client, board: Board, lines: list[SentenceLine], if_tested: str) -> None:
        self.board, self.lines = board, lines
        self._rtc = rtc
        self._if_tested = if_tested
        self._labels = Labels(lines)

    def run(self, which: Sequence[int]) -> list[m.CommandEnded]:
        """Send some lines at once, and wait for their ends."""

        def ended(i: int, one: m.CommandEnded) -> None:
            self.name(which[i], one.command)
            self.board.ended(which[i], one)

        tested = "" if all(is_test(self.lines[n].text) for n in which) else self._if_tested
        return self._rtc.run_many(
            [partial(self.text, n) for n in which],
            on_accept=lambda i, command: self._accepted(which[i], command),
            on_progress=self.board.progress,
            on_end=ended,
            about=AboutTest(if_tested=tested),
        )

    def text(self, n: int) -> str:
        """The sentence of line n to send now. It waits until the commands that it names have their numbers."""
        text = self.lines[n].text
        with suppress(TimedOut):  # the cluster refuses the name of a command that it has not accepted
            self._rtc.receive_until(lambda: self._labels.known(text), ANSWER_S, "a command has no number")
        text = self._labels.sent_as(text)
        self.board.sent_as(n, text)
        return text

    def name(self, n: int, command: str) -> None:
        """The command of line n, or empty: it is none."""
        if label := self.lines[n].label:
            self._labels.numbers.setdefault(label, command)

    def _accepted(self, n: int, command: str) -> None:
        self.name(n, command)
        self.board.accepted(n, command)
