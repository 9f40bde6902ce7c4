"""The commands as rows for a page, made of events and records; and the numbered changes that pages ask for again. Pure.

A row has what a track draws: phases, the spans in which a step was executed, trims, the outcome. Times are
CLOCK_MONOTONIC (s) of the cluster.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec

from rtc.protocol import messages as m
from rtc.protocol.outcomes import Outcome, Refusal, StopReason
from rtc.wording.notes import in_words

MAX_ROWS = 60  # commands that are kept; the oldest that have ended go first
MAX_SPANS = 200  # per command; the oldest go first
MAX_LOG = 200  # lines that are kept of halts, refusals and reports
MAX_CHANGES = 400  # messages that a page may ask for again


class Span(msgspec.Struct, kw_only=True):
    """A step while a subsystem executed it. `reason`, `message`: with which it ended; no reason: it is executed now."""

    step: str
    node: str
    from_s: float
    to_s: float | None = None
    reason: StopReason | None = None
    message: str = ""
    expected_s: float = 0.0


class Mark(msgspec.Struct, frozen=True, kw_only=True):
    """A moment of a command: a trim, or a warning."""

    at_s: float
    kind: str
    words: str


class Row(msgspec.Struct, kw_only=True):
    """One command."""

    command: str
    text: str = ""
    source: str = ""
    accepted_at_s: float
    phase: str
    step: str = ""
    expected_s: float = 0.0  # planned duration of the step that was bound last
    phases: list[tuple[str, float]] = []  # each phase, and when it began
    spans: list[Span] = []
    marks: list[Mark] = []
    performers: list[str] = []  # arms that it has moved or that its sentence names
    outcome: Outcome | None = None
    ended_at_s: float | None = None
    last_seq: int = 0


class LogLine(msgspec.Struct, frozen=True, kw_only=True):
    """An event that is not about the phases of a command."""

    at_s: float
    kind: str  # halt, refusal, report or lost
    words: str
    text: str = ""
    refusal: Refusal | None = None
    measured: Any = None


class Change(msgspec.Struct, frozen=True, kw_only=True):
    """What has changed since the change before: rows and lines."""

    n: int
    rows: list[Row] = []
    lines: list[LogLine] = []


class Snapshot(msgspec.Struct, frozen=True, kw_only=True):
    """Everything up to change `n`."""

    n: int
    rows: list[Row]
    lines: list[LogLine]


class Story:
    """Takes events; `flush` numbers what has changed; `since` gives it again, or everything after too long a gap."""

    def __init__(self, arms: Sequence[str], hands: dict[str, str]) -> None:
        self._words = {**{arm: arm for arm in arms}, **hands}  # arm or end effector -> arm
        self.rows: dict[str, Row] = {}
        self.lines: deque[LogLine] = deque(maxlen=MAX_LOG)
        self._changed: set[str] = set()
        self._new_lines: list[LogLine] = []
        self._changes: deque[bytes] = deque(maxlen=MAX_CHANGES)
        self.n = 0

    # --- what arrives ---------------------------------------------------------------------------------

    def take(self, event: m.Event) -> None:
        match event:
            case m.ProgressNote() if event.seq == 0:
                words = in_words(event) or event.step
                self._add(LogLine(at_s=event.at_s, kind="report", words=words, measured=event.measured))
            case m.ProgressNote() if event.command:
                self._note(self._row(event.command, event), event)
            case m.CommandEnded() if event.command:
                row = self._row(event.command, event)
                row.text, row.outcome = event.text, event.outcome
                row.ended_at_s, row.phase = event.at_s, m.Phase.ENDED
                row.last_seq = max(row.last_seq, event.seq)
                _close(row, event.at_s)
                self._touch(row)
            case m.RequestRefused():
                words = event.refusal.message
                self._add(LogLine(at_s=event.at_s, kind="refusal", words=words, text=event.text, refusal=event.refusal))
            case m.HaltRequested():
                words = f"HALT {event.scope}" + (f": {event.refused}" if event.refused else "")
                self._add(LogLine(at_s=event.at_s, kind="halt", words=words))

    def take_record(self, record: m.CommandRecord) -> None:
        """The whole record of a command replaces what is known of it."""
        before = self.rows.get(record.command)
        row = Row(command=record.command, accepted_at_s=record.accepted_at_s, phase=record.phase)
        row.text, row.source = record.text, record.source
        row.performers = list(before.performers) if before else []
        self.rows[record.command] = row
        for note in record.notes:
            self._note(row, note)
        row.phase, row.outcome, row.ended_at_s = record.phase, record.outcome, record.ended_at_s
        if record.ended_at_s is not None:
            _close(row, record.ended_at_s)
        self._named(row)
        self._touch(row)

    def take_performing(self, performers: Iterable[tuple[str, str]]) -> None:
        """Pairs of an arm and the command that it executes now."""
        for arm, command in performers:
            row = self.rows.get(command)
            if row is not None and arm not in row.performers:
                row.performers.append(arm)
                self._touch(row)

    def take_lost(self, count: int, now_s: float) -> None:
        self._add(LogLine(at_s=now_s, kind="lost", words=f"{count} events did not arrive; the records are read again"))

    # --- what leaves ----------------------------------------------------------------------------------

    @property
    def live(self) -> list[str]:
        return [row.command for row in self.rows.values() if row.ended_at_s is None]

    def flush(self) -> bytes | None:
        """The next numbered change as JSON; None if nothing has changed."""
        if not self._changed and not self._new_lines:
            return None
        self.n += 1
        rows = [self.rows[name] for name in sorted(self._changed, key=_number) if name in self.rows]
        change = msgspec.json.encode({"change": Change(n=self.n, rows=rows, lines=self._new_lines)})
        self._changed, self._new_lines = set(), []
        self._changes.append(change)
        return change

    def since(self, n: int) -> list[bytes]:
        """The changes after number `n`; if they are not all kept, a snapshot."""
        missing = self.n - n
        if 0 <= missing <= len(self._changes) and n > 0:
            return list(self._changes)[len(self._changes) - missing :]
        rows = [self.rows[name] for name in sorted(self.rows, key=_number)]
        return [msgspec.json.encode({"snapshot": Snapshot(n=self.n, rows=rows, lines=list(self.lines))})]

    # --- inside ---------------------------------------------------------------------------------------

    def _row(self, command: str, event: m.ProgressNote | m.CommandEnded) -> Row:
        if command not in self.rows:
            at_s = event.at_s - (event.took_s if isinstance(event, m.CommandEnded) else 0.0)
            self.rows[command] = Row(command=command, accepted_at_s=at_s, phase="")
            self._forget_oldest()
        return self.rows[command]

    def _note(self, row: Row, note: m.ProgressNote) -> None:
        if note.seq <= row.last_seq:
            return  # it was in the record
        row.last_seq = note.seq
        row.expected_s = note.expected_s or row.expected_s
        if not row.phases or row.phases[-1][0] != note.phase:
            row.phases.append((note.phase, note.at_s))
            del row.phases[:-MAX_SPANS]
        if note.kind is m.NoteKind.STARTED:
            row.spans.append(Span(step=note.step, node=note.node, from_s=note.at_s, expected_s=row.expected_s))
            del row.spans[:-MAX_SPANS]
        elif note.kind is m.NoteKind.STEP_ENDED and row.spans:
            row.spans[-1].to_s, row.spans[-1].reason = note.at_s, note.reason
            row.spans[-1].message = note.message
        if note.trim:
            row.marks.append(Mark(at_s=note.at_s, kind="trim", words=in_words(note)))
        if note.warning:
            row.marks.append(Mark(at_s=note.at_s, kind="warning", words=in_words(note)))
        row.phase, row.step = note.phase, note.step
        self._touch(row)

    def _named(self, row: Row) -> None:
        """The arms whose names or hands are words of the sentence."""
        for word in row.text.upper().replace("_", "-").split():
            arm = self._words.get(word.strip(",.()"))
            if arm and arm not in row.performers:
                row.performers.append(arm)

    def _touch(self, row: Row) -> None:
        self._changed.add(row.command)

    def _add(self, line: LogLine) -> None:
        self.lines.append(line)
        self._new_lines.append(line)

    def _forget_oldest(self) -> None:
        ended = [name for name, row in self.rows.items() if row.ended_at_s is not None]
        for name in ended[: max(0, len(self.rows) - MAX_ROWS)]:
            del self.rows[name]


def _close(row: Row, at_s: float) -> None:
    if row.spans and row.spans[-1].to_s is None:
        row.spans[-1].to_s = at_s


def _number(command: str) -> int:
    digits = command.removeprefix("C-")
    return int(digits) if digits.isdigit() else 0
