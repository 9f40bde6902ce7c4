"""The REPORT clause, and how long a step takes."""

from __future__ import annotations

import msgspec

from broker.decisions import effects as do
from broker.decisions.events import PrimitiveEnded
from rtc.apps.cli.measured import in_words
from rtc.protocol.outcomes import StopReason
from rtc.protocol.sentence import Report
from tests.broker.harness import Harness, bound, go_on, record, report


def test_what_was_measured_is_in_the_outcome_and_in_the_note_as_far_as_it_was_asked_for():
    s = Harness()
    s.executing(report=Report(pose=True, forces=True))
    s.reports("C-1")
    s.answers("C-1", go_on())

    measured = s.outcome("C-1").measured
    assert (measured.arm, measured.tcp_pose, measured.wrench) == ("RIGHT-ARM", [0, 0, 0, 0, 0, 0, 1], [0.0] * 6)
    assert measured.joints is None
    assert [e.note.measured for e in s.log if isinstance(e, do.PublishNote) and e.note.measured] == [measured]


def test_a_halted_command_reports_what_was_measured_too():
    s = Harness()
    s.executing(report=Report(joints=True))
    s.halts("C-1")
    s.reports("C-1", StopReason.HALT)
    s.answers("C-1", go_on())
    assert s.outcome("C-1").measured.joints == [0.0] * 6


def test_of_two_arms_both_are_reported():
    s = Harness()
    s.executing(report=Report(joints=True, pose=True))
    both = msgspec.structs.replace(report("C-1.1"), partner=report("C-1.1", performer="LEFT-ARM"))
    s.handle(PrimitiveEnded, subsystem="MCM", report=both)
    s.answers("C-1", go_on())

    second = s.outcome("C-1").measured.partner
    assert (second.arm, second.joints, second.tcp_pose) == ("LEFT-ARM", [0.0] * 6, [0, 0, 0, 0, 0, 0, 1])
    assert [line.split()[0] for line in in_words(s.outcome("C-1").measured)] == ["RIGHT-ARM"] * 2 + ["LEFT-ARM"] * 2


def test_without_report_nothing_is_added():
    s = Harness()
    s.analyzing()
    s.answers("C-1", go_on())
    assert s.outcome("C-1").measured is None


def test_periodic_reports_without_a_receiver_are_refused():
    s = Harness()
    s.says("X", progress=False)
    s.answers("C-1", record(report=Report(every_s=0.5)))
    assert s.outcome("C-1").refusal.where == "EVERY"


def test_a_step_says_how_long_it_takes():
    s = Harness()
    s.state.timeout_scale = 2.0
    s.elaborated()
    s.answers("C-1", msgspec.structs.replace(bound("C-1.1"), predicted_s=4.2))
    assert s.state.commands["C-1"].notes[-1].expected_s == 8.4
