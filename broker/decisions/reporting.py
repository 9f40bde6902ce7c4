"""REPORT clause: readings during a motion, on their way from a subsystem to the client. Pure.

The router forwards reports of EVERY and WHEN directly, without the Decision Unit.
"""

from __future__ import annotations

from broker.decisions.state import Command, ReportHead
from rtc.protocol.messages import NoteKind, ProgressNote, ProgressReport

MAX_PER_S = 100  # maximum rate of periodic reports to one client; the rest is dropped and counted


def wants(command: Command | None, report: ProgressReport, subsystem: str) -> bool:
    """True if the report is from the current primitive of this command and its sentence requests it."""
    return (
        command is not None
        and command.progress
        and command.head is not None
        and command.head.report is not None
        and _asked(command.head.report, report)
        and (command.primitive, command.subsystem) == (report.primitive, subsystem)
    )


def _asked(asked: ReportHead, report: ProgressReport) -> bool:
    if report.condition is None:
        return asked.every_s is not None
    return 0 <= report.condition < len(asked.when)


def note_of(command: Command, report: ProgressReport, at_s: float) -> ProgressNote:
    """The progress note with the reading, which is passed on unread."""
    assert command.head is not None
    asked = command.head.report
    assert asked is not None
    condition = None if report.condition is None else asked.when[report.condition]
    return ProgressNote(
        seq=0,  # not part of the event stream, because it bypasses the Decision Unit
        at_s=at_s,
        command=command.id,
        phase=command.phase,
        step=command.step_words,
        node=command.subsystem,
        kind=NoteKind.REPORT if condition is None else NoteKind.CONDITION,
        message="" if condition is None else condition.sentence,
        value=None if condition is None else report.measured,
        unit=condition.quantity.unit if condition is not None and condition.quantity is not None else "",
        measured=report.reading,
    )
