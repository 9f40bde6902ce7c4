"""Progress of commands: a live board on a terminal, elsewhere one plain line per change.

A client's callbacks feed it; it sends no messages.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from rtc.apps.cli.output import COLOUR, console, table
from rtc.protocol import messages as m
from rtc.protocol.outcomes import OutcomeKind
from rtc.wording import notes as wording
from rtc.wording.measured import duration, in_words, seconds
from rtc.wording.outcomes import explain
from rtc.wording.sentences import quoted

WAITS = (m.Phase.HELD, m.Phase.WAITING)  # the note names what the command waits for
#: phases that are too short for their own line (`rtc trace` shows them); ENDED has the result line
PASSING = {m.Phase.PARSING, m.Phase.REHEARSING, m.Phase.ELABORATING, m.Phase.BINDING, m.Phase.ANALYZING, m.Phase.ENDED}


REPORTS_KEPT = 1000  # maximum number of reports of EVERY and WHEN per command in the JSON result


@dataclass
class BoardRow:
    text: str
    label: str = ""  # of its line in a program
    command: str = ""
    phase: str = "waiting"
    step: str = ""  # as displayed
    of: str = ""  # as in the last note
    started_s: float = field(default_factory=time.monotonic)


class Board:
    """Context manager. `labels`: one for each text; `quiet`: show nothing (for --json); `out`: the output."""

    def __init__(
        self, texts: list[str], labels: list[str] | None = None, *, quiet: bool = False, out: Console = console
    ) -> None:
        self._rows = [BoardRow(*row) for row in zip(texts, labels or [""] * len(texts), strict=True)]
        self._row_of: dict[str, BoardRow] = {}
        self.reports: dict[str, deque[m.ProgressNote]] = {}  # command -> its latest reports of EVERY and WHEN
        self.reports_older: Counter[str] = Counter()  # command -> number of those before them
        self.on_long: Callable[[m.ProgressNote], None] | None = None  # called with every note; asks about a long step
        self.kinds: list[OutcomeKind] = []  # outcomes of all ended commands
        self.quiet = quiet
        self._out = out
        self._live: Live | None = None
        self._begun_s = time.monotonic()
        if not quiet and out.is_terminal:
            self._live = self._new_live()

    def __enter__(self) -> Board:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.pause()

    def pause(self) -> None:
        """Stop drawing, for a question to the operator."""
        if self._live:
            self._live.stop()

    def resume(self) -> None:
        """Continue below the printed lines, with a new live view: a restarted one would overwrite them."""
        if self._live:
            self._live = self._new_live()
            self._live.start()

    def _new_live(self) -> Live:
        return Live(get_renderable=self._table, console=self._out, refresh_per_second=8, transient=True)

    @property
    def running(self) -> list[str]:
        """Numbers of the commands without a known end."""
        return list(self._row_of)

    def sent_as(self, n: int, text: str) -> None:
        """The sentence as it is sent: with numbers of commands in place of labels."""
        self._rows[n].text = text

    def accepted(self, n: int, command: str) -> None:
        row = self._rows[n]
        row.command, row.phase, row.started_s = command, "accepted", time.monotonic()
        self._row_of[command] = row
        self._line(f"{command}  accepted  {quoted(row.text)}")

    def progress(self, note: m.ProgressNote) -> None:
        if (row := self._row_of.get(note.command)) is None:
            return
        if note.seq == 0 and note.measured is not None:
            self._report(note)
            return
        if note.warning and not self.quiet:
            self._out.print(Text(f"{note.command}  warning: {wording.in_words(note)}", style="yellow"))
        if self.on_long is not None:
            self.on_long(note)
        changed = (note.phase.value, note.step) != (row.phase, row.of)
        row.of = note.step
        row.phase = note.phase.value
        row.step = what = wording.in_words(note) if note.phase in WAITS else note.step
        if note.expected_s:
            row.step += f" (about {duration(note.expected_s)})"
        if changed and note.phase not in PASSING:
            about = f"  about {duration(note.expected_s)}" if note.expected_s else ""
            self._line(f"{note.command}  {note.phase.value:<11} {what or wording.in_words(note)}{about}".rstrip())

    def _report(self, note: m.ProgressNote) -> None:
        """A report of EVERY or WHEN: a line on the screen, or kept for the JSON result."""
        assert note.measured is not None
        kept = self.reports.setdefault(note.command, deque(maxlen=REPORTS_KEPT))
        if len(kept) == REPORTS_KEPT:
            self.reports_older[note.command] += 1
        kept.append(note)
        if not self.quiet:
            words = "; ".join(line.strip() for line in [wording.in_words(note), *in_words(note.measured)] if line)
            self._out.print(Text(f"{time.monotonic() - self._begun_s:7.2f} s  {note.command}  {words}"))

    def ended(self, n: int, ended: m.CommandEnded) -> None:
        """Print the result line permanently, above the board."""
        row = self._rows[n]
        row.phase = "ended"
        self.kinds.append(ended.outcome.kind)
        self._row_of.pop(ended.command, None)
        if self._live:
            self._live.refresh()  # without the row, before the result is printed above the board
        if not self.quiet:
            print_result(ended, row.text, self._out, label=row.label)

    def _line(self, line: str) -> None:
        if self._live or self.quiet:
            return
        self._out.print(Text(f"{time.monotonic() - self._begun_s:7.2f} s  {line}"))

    def _table(self) -> Table | Text:
        if not self._row_of:
            return Text()
        out = table("", "phase", "step", "time>", "sentence")
        for row in self._row_of.values():
            age = seconds(time.monotonic() - row.started_s)
            out.add_row(row.command, row.phase, Text(row.step), age, Text(quoted(row.text), overflow="ellipsis"))
        return out


def print_result(ended: m.CommandEnded, text: str, out: Console = console, *, label: str = "") -> None:
    """One line with the outcome of a command; below it, without success, the cause and what would clear it."""
    kind = ended.outcome.kind
    head = Text(f"{ended.command or '(not taken)'} ", style="bold")
    head.append(kind.value.upper().replace("_", " "), style=COLOUR[kind])
    about = f"{label}, {_figures(ended)}" if label else _figures(ended)
    head.append(f"  {quoted(text)}  ").append(f"({about})", style="dim")
    out.print(head)
    for line in explain(ended, text):
        out.print(Text("    " + line))


def _figures(ended: m.CommandEnded) -> str:
    steps = ended.outcome.steps_done
    return (f"{steps} step{'s' if steps != 1 else ''}, " if steps else "") + seconds(ended.took_s)
