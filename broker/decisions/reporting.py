"""REPORT clause: measured values that a sentence requests beyond the standard end report. Pure.

The router forwards periodic reports directly, without the Decision Unit.
"""

from __future__ import annotations

from broker.decisions.state import Command
from rtc.protocol.messages import EndReport, ProgressNote, ProgressReport
from rtc.protocol.outcomes import Measured

MOST_PER_S = 100  # maximum rate of periodic reports to one client; the rest is dropped and counted


def at_end(command: Command, report: EndReport) -> Measured | None:
    """The requested values at the end of a primitive; None if none were requested or measured."""
    asked = command.head.report if command.head else None
    if asked is None or not (asked.joints or asked.forces or asked.pose) or not report.joints:
        return None
    return Measured(
        arm=report.performer,
        tcp_pose=report.tcp_pose if asked.pose else None,
        joints=report.joints if asked.joints else None,
        wrench=report.wrench if asked.forces else None,
        peak_force_n=report.peak_force_n if asked.forces else None,
        peak_torque_nm=report.peak_torque_nm if asked.forces else None,
    )


def wants_periodic(command: Command | None, report: ProgressReport, subsystem: str) -> bool:
    """True if the report is from the current primitive of this command and its sentence requests it."""
    return (
        command is not None
        and command.progress
        and command.head is not None
        and command.head.report is not None
        and command.head.report.every_s is not None
        and (command.primitive, command.subsystem) == (report.primitive, subsystem)
    )


def periodic(command: Command, report: ProgressReport, at_s: float) -> ProgressNote:
    """The progress note with the requested values. EVERY alone requests all measured values."""
    assert command.head is not None
    asked = command.head.report
    assert asked is not None
    everything = not (asked.joints or asked.forces or asked.pose)
    measured = Measured(
        arm=command.performers[0],
        tcp_pose=report.tcp_pose if asked.pose or everything else None,
        joints=report.joints if asked.joints or everything else None,
        wrench=report.wrench if asked.forces or everything else None,
    )
    return ProgressNote(
        seq=0,  # not part of the event stream, because it bypasses the Decision Unit
        at_s=at_s,
        command=command.id,
        phase=command.phase,
        step=command.step_words,
        node=command.subsystem,
        measured=measured,
    )
