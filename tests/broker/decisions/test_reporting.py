"""The REPORT clause, and how long a step takes."""

from __future__ import annotations

import msgspec

from broker.decisions import effects as do
from broker.decisions import reporting
from broker.decisions.events import PrimitiveEnded
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Measured, StopReason
from rtc.protocol.sentence import Condition, Report
from rtc.wording import notes
from rtc.wording.measured import in_words
from tests.broker.harness import Harness, bound, go_on, record, report

READING = Measured(arm="RIGHT-ARM", tcp_pose=[0, 0, 0, 0, 0, 0, 1], others={"TEMPERATURE": {"motor_c": [41.5]}})


def test_a_reading_is_in_the_outcome_and_in_the_note_as_it_was_sent():
    s = Harness()
    s.executing(report=Report(items=["POSE", "TEMPERATURE"]))
    s.handle(PrimitiveEnded, subsystem="MCM", report=msgspec.structs.replace(report("C-1.1"), reading=READING))
    s.answers("C-1", go_on())

    assert s.outcome("C-1").measured == READING
    assert [e.note.measured for e in s.log if isinstance(e, do.PublishNote) and e.note.measured] == [READING]


def test_a_halted_command_reports_what_was_measured_too():
    s = Harness()
    s.executing(report=Report(items=["POSE"]))
    s.halts("C-1")
    ended = report("C-1.1", StopReason.HALT)
    s.handle(PrimitiveEnded, subsystem="MCM", report=msgspec.structs.replace(ended, reading=READING))
    s.answers("C-1", go_on())
    assert s.outcome("C-1").measured == READING


def test_a_reading_in_words_has_a_line_for_each_item_of_each_arm():
    both = msgspec.structs.replace(READING, partner=Measured(arm="LEFT-ARM", joints=[0.0] * 6))
    assert [line.split()[:2] for line in in_words(both)] == [
        ["RIGHT-ARM", "pose:"],
        ["RIGHT-ARM", "temperature:"],
        ["LEFT-ARM", "joints:"],
    ]


def test_a_condition_that_is_true_has_its_figure_without_an_exponent():
    s = Harness()
    s.executing(report=Report(when=[Condition(event="CONTACT")]))
    met = m.ProgressReport(primitive="C-1.1", at_s=1.0, reading=READING, condition=0, measured=1240.4)
    note = reporting.note_of(s.state.commands["C-1"], met, 1.0)
    assert notes.in_words(note) == "CONTACT: 1240"


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
