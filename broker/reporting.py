"""REPORT: what a sentence asks to be reported beyond the standard end report, taken from what its subsystem reports.

Periodic reports pass by the Decision Unit, which lives on events: the router forwards them. Pure.
"""

from __future__ import annotations

from broker.state import Command
from rtc.messages import EndReport, ProgressNote, ProgressReport
from rtc.outcomes import Measured

MOST_PER_S = 100  # periodic reports that one broker forwards to one client in a second; the rest is dropped and counted


def at_end(command: Command, report: EndReport) -> Measured | None:
    """What was measured at the end of a primitive, as far as it was asked for."""
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
    """The report is of the primitive that this command executes now, and its sentence asks for it."""
    return (
        command is not None
        and command.progress
        and command.head is not None
        and command.head.report is not None
        and command.head.report.every_s is not None
        and (command.primitive, command.subsystem) == (report.primitive, subsystem)
    )


def periodic(command: Command, report: ProgressReport, at_s: float) -> ProgressNote:
    """For the client that gave the command. EVERY alone means everything that is measured."""
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
        seq=0,  # not of the event stream: it passes the Decision Unit by
        at_s=at_s,
        command=command.id,
        phase=command.phase,
        step=command.step_words,
        node=command.subsystem,
        measured=measured,
    )
