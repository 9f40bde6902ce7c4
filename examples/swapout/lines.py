"""Lines of a task, given to a cluster as a planner gives them: each as soon as the lines that it depends on have ended.

A line depends on the last earlier line that names the same arm, object or camera, and on those of `after`. So lines
about different things are in progress at once. What the cluster itself must keep apart (two arms in one space, one
camera for two looks) waits there.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from rtc.client.client import Client
from rtc.client.handle import CommandHandle
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.sentence import BOTH_ARMS

LINE = re.compile(r"(C\d+): (.+)")
COMMAND = re.compile(r"\bC-(\d+)\b")
WORD = re.compile(r"[A-Z][A-Z0-9-]*")


class Line(NamedTuple):
    label: str  # C7
    text: str


def read(text: str) -> list[Line]:
    """The lines with a label, in order."""
    return [Line(*found.groups()) for found in map(LINE.fullmatch, text.splitlines()) if found]


def waits(lines: list[Line], cell: Cell, after: Mapping[str, str]) -> dict[str, set[str]]:
    """The labels of the lines that each line waits for. `after`: what no name shows; label -> label."""
    hands = {arm.end_effector: arm.name for arm in cell.arms}
    known = {*hands.values(), *(thing.name for thing in cell.objects), *(camera.name for camera in cell.cameras)}
    last: dict[str, str] = {}
    found: dict[str, set[str]] = {}
    for line in lines:
        words = {hands.get(word, word) for word in WORD.findall(line.text)}
        things = set(hands.values()) if BOTH_ARMS in words else set()
        things |= words & known
        found[line.label] = {last[thing] for thing in things & last.keys()}
        if line.label in after:
            found[line.label].add(after[line.label])
        if not line.text.startswith("TEST "):
            last |= dict.fromkeys(things, line.label)
    return found


def among(given: Collection[str], needed: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """What each of the given lines waits for. A line that is not given stands for those that it waits for."""

    def through(label: str) -> set[str]:
        return {label} if label in given else set().union(*map(through, needed[label]))

    return {label: set().union(*map(through, needed[label])) for label in given}


@dataclass
class Course:
    """What became of each line: command, times of execution in seconds of the demo, end.

    The times are those of the broker, which has the same clock: on a busy machine its events come here later."""

    begun_s: float = field(default_factory=time.monotonic)
    commands: dict[str, str] = field(default_factory=dict)  # label -> C-7
    texts: dict[str, str] = field(default_factory=dict)  # label -> sentence, as given
    executing: dict[str, list[float]] = field(default_factory=dict)  # label -> from, to
    held: set[str] = field(default_factory=set)  # labels of lines that waited in the cluster for another command
    ends: dict[str, m.CommandEnded] = field(default_factory=dict)
    #: label -> its steps whose duration was compared: (words of the step, simulated s)
    measured: dict[str, list[tuple[str, float]]] = field(default_factory=dict)

    @property
    def now_s(self) -> float:
        return time.monotonic() - self.begun_s

    def notes(self, rtc: Client, label: str) -> list[m.ProgressNote]:
        """Of the command of a line, as the cluster keeps them."""
        return rtc.trace(self.commands[label]).notes

    def note(self, label: str, note: m.ProgressNote) -> None:
        if note.phase is m.Phase.EXECUTING:
            at_s = note.at_s - self.begun_s
            self.executing.setdefault(label, [at_s, at_s])[1] = at_s
        elif note.phase is m.Phase.HELD:
            self.held.add(label)
        if note.compared is not None:
            figures, step = note.compared.figures, note.compared.label
            took = [(step, figure.measured) for figure in figures if figure.name == "duration_s"]
            self.measured.setdefault(label, []).extend(took)

    def end(self, label: str, ended: m.CommandEnded) -> None:
        self.ends[label] = ended
        if label in self.executing:
            self.executing[label][1] = ended.at_s - self.begun_s

    def together(self, labels: Collection[str]) -> int:
        """The greatest number of these lines that were in execution at one time."""
        spans = [span for label, span in self.executing.items() if label in labels]
        return max((sum(a <= start < b for a, b in spans) for start, _ in spans), default=0)


class Planner:
    """Gives the lines to a cluster, and stops after one that ended otherwise than it should.

    `lasting`: lines that last until another line ends them; no line waits for them."""

    def __init__(
        self,
        rtc: Client,
        needed: Mapping[str, set[str]],
        lasting: Collection[str],
        on_begin: Callable[[Line], None],
        on_note: Callable[[Line, m.ProgressNote], None],
        on_end: Callable[[Line, m.CommandEnded], bool],
    ) -> None:
        self.course = Course()
        self._rtc, self._needed, self._lasting = rtc, needed, lasting
        self._on_begin, self._on_note = on_begin, on_note
        self._on_end = on_end  # whether it ended as it should

    def perform(self, lines: list[Line], timeout_s: float) -> Course:
        """Raises TimedOut if no line ends within `timeout_s`."""
        todo, open_ = list(lines), dict[str, tuple[Line, CommandHandle]]()
        while todo or open_:
            for line in [line for line in todo if self._ready(line)]:
                todo.remove(line)
                open_[line.label] = line, self._submit(line)
            self._rtc.receive_until(
                lambda: any(handle.ended for _, handle in open_.values()), timeout_s, "no line has ended"
            )
            for label, (line, handle) in list(open_.items()):
                if (ended := handle.ended) is None:
                    continue
                del open_[label]
                self.course.end(label, ended)
                if not self._on_end(line, ended):
                    return self.course
        return self.course

    def _ready(self, line: Line) -> bool:
        return self._needed[line.label] - set(self._lasting) <= self.course.ends.keys()

    def _submit(self, line: Line) -> CommandHandle:
        course = self.course
        text = COMMAND.sub(lambda found: course.commands[f"C{found[1]}"], line.text)
        course.texts[line.label] = text
        self._on_begin(line)

        def note(note: m.ProgressNote) -> None:
            course.note(line.label, note)
            self._on_note(line, note)

        handle = self._rtc.submit(text, on_progress=note)
        course.commands[line.label] = handle.number
        return handle
