"""The witness of long runs: it reads every event of a journal, and tells what it did not see from what is wrong."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.load.errands import Errand
from benchmarks.load.verdict import JournalReader, Verdict, judge
from broker.decisions.events import BrokerRestarted, PrimitiveEnded
from broker.decisions.state import State
from broker.persistence.journal import Journal
from rtc.protocol.outcomes import Outcome, OutcomeKind
from tests.broker.harness import report

LIMIT_S = 10.0
OTHER = BrokerRestarted(at_s=0.0)
ENDED = PrimitiveEnded(at_s=1.0, subsystem="MCM", report=report("C-1.1"))


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "MCM.log").write_text("RIGHT-ARM begins C-1.1\n")
    journal = Journal.open(tmp_path / "journal.db", "run", State())
    yield journal
    journal.close()


def delete_what_is_unnecessary(journal: Journal) -> None:
    journal.db.execute("DELETE FROM snapshots")  # as if all of them were newer
    journal.snapshot(State())
    journal.tidy()


def verdict(run_dir: Path, reader: JournalReader, goal_rad: float = 0.0) -> Verdict:
    outcome = Outcome(kind=OutcomeKind.SUCCEEDED)
    errand = Errand("RIGHT-ARM", "STOW RIGHT-ARM", (goal_rad,) * 6, 0.0, 2.0, "C-1", outcome)
    return judge([errand], reader, run_dir, [])


def test_a_true_outcome_is_true_and_one_at_another_place_is_wrong(tmp_path, journal):
    reader = JournalReader(tmp_path)
    journal.append([ENDED], [])
    reader.read()

    assert verdict(tmp_path, reader).faultless
    assert len(verdict(tmp_path, reader, goal_rad=1.0).wrong) == 1


def test_an_outcome_without_a_report_in_a_complete_journal_is_wrong(tmp_path, journal):
    reader = JournalReader(tmp_path)
    journal.append([OTHER], [])
    reader.read()

    found = verdict(tmp_path, reader)
    assert (len(found.wrong), found.not_seen, found.missed) == (1, [], 0)


def test_an_outcome_whose_report_was_deleted_unread_is_not_seen_and_nothing_is_judged(tmp_path, journal):
    reader = JournalReader(tmp_path)
    journal.append([OTHER], [])
    reader.read()
    for events in ([ENDED], [OTHER], [OTHER]):
        journal.append(events, [])
    delete_what_is_unnecessary(journal)
    reader.read()

    found = verdict(tmp_path, reader)
    assert (found.wrong, len(found.not_seen), found.missed) == ([], 1, 2)
    assert not found.faultless


def test_a_reader_that_follows_sees_what_is_deleted_before_the_next_look(tmp_path, journal):
    reader = JournalReader(tmp_path)
    reader.follow()
    for events in ([OTHER], [ENDED], [OTHER]):
        journal.append(events, [])
    end_s = time.monotonic() + LIMIT_S
    while len(reader.events) < 3:
        assert time.monotonic() < end_s
        threading.Event().wait(0.005)
    delete_what_is_unnecessary(journal)
    journal.append([OTHER], [])

    assert len(reader.read()) == 4
    assert verdict(tmp_path, reader).faultless
    assert reader.missed == 0
    reader.close()
