"""A progress note in words."""

from __future__ import annotations

from collections.abc import Callable

from rtc.protocol.messages import NoteKind, ProgressNote
from rtc.protocol.units import figure, measured_in_words


def in_words(note: ProgressNote) -> str:
    """What the note states; empty if that is no more than its phase."""
    made = MADE.get(note.kind)
    return made(note) if made else TEXTS[note.kind].format(note)


def judged(note: ProgressNote) -> str:
    """What the analyzer says of a step, without its trim and its drift."""
    as_expected = "" if note.kind is NoteKind.TRIM else ": as expected"
    return "; ".join(filter(None, (note.message, note.found))) or f"{note.reason}{as_expected}"


def trim(note: ProgressNote) -> str:
    """The trim that the analyzer has chosen, and what has drifted: "trim 2, regrasp MACS-NEW"."""
    return f"trim {note.trim}, {'; then '.join(note.pieces)}{_drift(note)}"


def _drift(note: ProgressNote) -> str:
    return f"; {note.drift}" if note.drift else ""


def _condition(note: ProgressNote) -> str:
    if note.value is None:
        return note.message
    value = measured_in_words(note.value, note.unit).upper() if note.unit else figure(note.value)
    return f"{note.message}: {value}"


#: what `str.format` makes words of, with the note as its only argument
TEXTS = {
    NoteKind.PHASE: "",
    NoteKind.PARSED_BEFORE: "parsed before",
    NoteKind.IN_USE: "{0.about} is in use by {0.owner}",
    NoteKind.IN_USE_PAUSED: ("{0.about} is in use by {0.owner}, which is paused: {0.clears[0]}, or {0.clears[1]}"),
    NoteKind.IN_USE_OPERATOR: ("{0.about} is in use by {0.owner}: the operator has {0.arm}; {0.clears[0]} ends that"),
    NoteKind.AFTER: "waits for {0.owner} to succeed",
    NoteKind.TOGETHER: "waits for {0.owner} to begin",
    NoteKind.SURRENDERED: (
        "waits for the operator, who is asked to do what {0.owner} has failed to do; {0.clears[0]} goes on"
    ),
    NoteKind.ANSWERING: "answers {0.owner}",
    NoteKind.SPACE: "waits for space of {0.arm}, which {0.owner} moves: {0.message}",
    NoteKind.LOADING: "loads {0.about}",
    NoteKind.PLANNED: "{0.message}",
    NoteKind.PAUSED: "paused between two steps",
    NoteKind.BREAKPOINT: "breakpoint {0.about}; `rtc step {0.command}`, or {0.clears[0]}",
    NoteKind.MOTIONS_CHANGED: "another arm has begun to move meanwhile: planned again beside it",
    NoteKind.PLANNED_AGAIN: "{0.message}; planned again",
    NoteKind.BOUND: "{0.message}",
    NoteKind.STARTED: "started",
    NoteKind.WILL_PAUSE_FIRST: "will pause before its first step",
    NoteKind.WILL_PAUSE: "will pause before its next step",
    NoteKind.SLOWS_DOWN: "slows down on its path",
    NoteKind.STANDS: "stands on its path, {0.value:.0%} done",
    NoteKind.GOES_ON: "goes on along its path",
    NoteKind.RESUMED: "resumed",
    NoteKind.REPORT: "",
    NoteKind.WORKER_LOST: "{0.about} lost ({0.message}); job again",
    NoteKind.ANALYSIS_AGAIN: "{0.message}; the analysis is repeated",
    NoteKind.PROGRAM_FAILED: "the {0.about} program {0.program} failed ({0.message}); the job is done with another",
    NoteKind.HALT: "halt {0.about}",
    NoteKind.STOPPING: "{0.message}",
    NoteKind.NOT_AT_REST: "{0.message}",
    NoteKind.SUBSYSTEM_LOST: "{0.message}",
    NoteKind.LAST_ANALYSIS: "{0.message}; the analysis continues, its verdict is ignored",
    NoteKind.JOURNAL_LOST: "{0.message}",
}
MADE: dict[NoteKind, Callable[[ProgressNote], str]] = {
    NoteKind.ASSIGNED: lambda note: note.message or "nothing to execute",
    NoteKind.STEP_ENDED: lambda note: f"ended: {note.reason}" + (f" ({note.message})" if note.message else ""),
    NoteKind.JUDGED: lambda note: judged(note) + _drift(note),
    NoteKind.TRIM: lambda note: f"{judged(note)}: {trim(note)}",
    NoteKind.CONDITION: _condition,
    NoteKind.AT_REST: lambda note: f"at rest: {note.reason or 'it had not begun'}",
    NoteKind.OUTCOME: lambda note: f"{note.outcome}: {note.message}" if note.message else f"{note.outcome}",
}
