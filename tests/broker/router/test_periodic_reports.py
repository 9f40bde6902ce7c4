"""Reports of EVERY and WHEN go to the client, and a limited number is kept."""

from __future__ import annotations

import msgspec
import pytest

from broker.decisions.reporting import MAX_PER_S
from broker.decisions.state import ParsedHead, ReportHead
from broker.router.recent_reports import COMMANDS, REPORTS, RecentReports
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Measured
from rtc.protocol.sentence import Condition, Quantity
from rtc.wording.notes import in_words
from tests.broker.router.bench import Bench, forwarded


@pytest.fixture
def reporting(working: Bench) -> Bench:
    """Ann's command is being executed, and its sentence asks for periodic reports."""
    command = working.state.commands["C-1"]
    command.head = ParsedHead(kind="task", verb="STOW", report=ReportHead(every_s=0.5))
    command.primitive, command.subsystem, command.performers = "C-1.1", "MCM", ["LEFT-ARM"]
    working.sockets["front"].sent.clear()
    return working


def progress(primitive: str = "C-1.1") -> m.ProgressReport:
    return m.ProgressReport(primitive=primitive, at_s=1.0, reading=Measured(arm="LEFT-ARM", joints=[0.5]))


def test_a_periodic_report_goes_to_the_client_and_past_the_journal(reporting: Bench) -> None:
    before = (reporting.router.core.journal.events_since_snapshot, reporting.state.seq)

    reporting.send("subsystems", b"MCM", progress())

    [note] = forwarded(reporting)
    assert (note.seq, note.command, note.measured.joints, note.measured.tcp_pose) == (0, "C-1", [0.5], None)
    assert (reporting.router.core.journal.events_since_snapshot, reporting.state.seq) == before


def test_a_report_that_was_not_requested_is_dropped(reporting: Bench) -> None:
    reporting.send("subsystems", b"MCM", progress("C-1.0"), progress("C-9.1"))
    reporting.state.commands["C-1"].head = ParsedHead(kind="task", verb="STOW", report=ReportHead())
    reporting.send("subsystems", b"MCM", progress())
    assert forwarded(reporting) == []


def test_periodic_reports_are_bounded(reporting: Bench) -> None:
    reporting.send("subsystems", b"MCM", *[progress()] * (2 * MAX_PER_S))
    assert len(forwarded(reporting)) == MAX_PER_S
    assert reporting.router.core.dropped["reports"] == MAX_PER_S


def test_a_condition_goes_to_the_client_in_the_words_of_its_sentence(reporting: Bench) -> None:
    force = Condition(measure="FORCE", bound="above", quantity=Quantity(5.0, "N"))
    head = ReportHead(when=[Condition(event="CONTACT"), force])
    reporting.state.commands["C-1"].head = ParsedHead(kind="task", verb="STOW", report=head)

    met = {"measured": 6.0, "limit": 5.0}
    reports = [msgspec.structs.replace(progress(), condition=n, **met) for n in (1, 0, 2)]
    reporting.send("subsystems", b"MCM", *reports)

    assert [in_words(note) for note in forwarded(reporting)] == ["FORCE EXCEEDS 5 N: 6 N", "CONTACT: 6"]


def test_the_latest_reports_are_in_the_trace_and_older_ones_counted(reporting: Bench) -> None:
    reporting.send("subsystems", b"MCM", *[progress()] * (REPORTS + 3))
    (reply,) = reporting.send("front", b"bob", m.TraceQuery(request="q", command="C-1"))
    assert (len(reply.record.reports), reply.record.reports_older) == (REPORTS, 3)
    assert reply.record.reports[0].measured.joints == [0.5]


def test_reports_are_kept_of_the_latest_commands_only() -> None:
    kept = RecentReports()
    for n in range(COMMANDS + 1):
        kept.keep(m.ProgressNote(seq=0, at_s=0.0, command=f"C-{n}", phase=m.Phase.EXECUTING))
    records = [
        m.CommandRecord(command=f"C-{n}", text="", source="", request="", accepted_at_s=0.0, phase=m.Phase.ENDED)
        for n in range(COMMANDS + 1)
    ]
    assert [len(kept.add_to(record).reports) for record in records] == [0] + [1] * COMMANDS
