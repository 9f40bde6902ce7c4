"""The jobs of recent commands can be read from the journal, with their inputs, answers and programs."""

from __future__ import annotations

import pytest

from broker.decisions.events import ProgramInstalled
from broker.decisions.state import State
from broker.persistence.journal import Journal
from broker.persistence.recorded_jobs import recorded_jobs
from rtc.protocol import wire
from rtc.protocol.messages import AnalyzerInput, WorkerKind
from tests.broker.harness import go_on
from tests.broker.persistence.test_journal import Journalled


@pytest.fixture
def s(tmp_path):
    journal = Journal.open(tmp_path / "journal.db", "run", State())
    journal.keep_program("parser-1", b"a grammar")
    journal.keep_program("other", b"not used")
    s = Journalled(journal)
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="parser-1")
    return s


def kinds(found):
    return [job.kind.value for job in found.jobs]


def test_each_answered_job_has_its_input_its_answer_and_its_program(s):
    s.analyzing()
    s.answers("C-1", go_on())
    found = recorded_jobs(s.journal, "C-1")
    assert kinds(found) == ["parser", "elaborator", "binder", "analyzer"]
    assert wire.decoder(AnalyzerInput)(found.jobs[-1].job.input).report.primitive
    assert bytes(found.jobs[-1].answer.product) == wire.encode(go_on())
    assert found.bodies == {"parser-1": b"a grammar"}


def test_jobs_of_other_commands_and_jobs_without_an_answer_are_left_out(s):
    s.analyzing()
    s.answers("C-1", go_on())
    s.executing()
    assert kinds(recorded_jobs(s.journal, "C-2")) == ["parser", "elaborator", "binder"]
    assert kinds(recorded_jobs(s.journal, "C-3")) == []


def test_jobs_before_the_last_snapshot_are_kept_and_those_before_the_last_but_one_are_not(s):
    s.analyzing()
    s.answers("C-1", go_on())
    s.journal.snapshot(s.state)
    s.journal.tidy()
    assert len(recorded_jobs(s.journal, "C-1").jobs) == 4
    s.executing()
    s.journal.snapshot(s.state)
    s.journal.tidy()
    assert recorded_jobs(s.journal, "C-1").jobs == []
    assert len(recorded_jobs(s.journal, "C-2").jobs) == 3
