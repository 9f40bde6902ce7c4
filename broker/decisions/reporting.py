"""REPORT clause: measured values that a sentence requests beyond the standard end report. Pure.

The router forwards reports of EVERY and WHEN directly, without the Decision Unit.
"""

from __future__ import annotations

from broker.decisions.state import Command, ReportHead
from rtc.protocol.messages import EndReport, ProgressNote, ProgressReport
from rtc.protocol.outcomes import Measured

MAX_PER_S = 100  # maximum rate of periodic reports to one client; the rest is dropped and counted


def at_end(command: Command, report: EndReport) -> Measured | None:
    """The requested values at the end of a primitive; None if none were requested or measured."""
    asked = command.head.report if command.head else None
    if asked is None or not (asked.joints or asked.forces or asked.pose):
        return None
    if report.sighting is not None:
        return Measured(arm=report.performer, sighting=report.sighting) if asked.pose else None
    if not report.joints:
        return None
    return Measured(
        arm=report.performer,
        tcp_pose=report.tcp_pose if asked.pose else None,
        joints=report.joints if asked.joints else None,
        slides=report.slides if asked.joints else [],
        wrench=report.wrench if asked.forces else None,
        peak_force_n=report.peak_force_n if asked.forces else None,
        peak_torque_nm=report.peak_torque_nm if asked.forces else None,
        partner=at_end(command, report.partner) if report.partner else None,
    )


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
    """The progress note with the requested values. EVERY or WHEN alone requests all measured values."""
    assert command.head is not None
    asked = command.head.report
    assert asked is not None
    everything = not (asked.joints or asked.forces or asked.pose)
    measured = Measured(
        arm=command.performers[0],
        tcp_pose=report.tcp_pose if (asked.pose or everything) and report.tcp_pose else None,
        joints=report.joints if (asked.joints or everything) and report.joints else None,
        slides=report.slides if asked.joints or everything else [],
        wrench=report.wrench if (asked.forces or everything) and report.wrench else None,
        sighting=report.sighting if asked.pose or everything else None,
    )
    return ProgressNote(
        seq=0,  # not part of the event stream, because it bypasses the Decision Unit
        at_s=at_s,
        command=command.id,
        phase=command.phase,
        step=command.step_words,
        node=command.subsystem,
        note=_met(asked, report),
        measured=measured,
    )


def _met(asked: ReportHead, report: ProgressReport) -> str:
    """The condition that is true, in the words of the sentence, with the measured value; empty if it is periodic."""
    if report.condition is None:
        return ""
    condition = asked.when[report.condition]
    if report.measured is None:
        return condition.sentence
    return f"{condition.sentence}: {condition.measured_in_words(report.measured) or f'{report.measured:.3g}'}"
