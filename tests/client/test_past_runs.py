"""What a run has left behind is read without any process: the journal is written here as the broker writes it."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from broker.decisions.state import State
from broker.persistence.journal import Journal
from rtc.apps.cli import log, trace
from rtc.client.past_runs import PREVIOUS, Past, runs
from rtc.protocol import messages as m
from rtc.protocol.outcomes import NoCluster, Outcome, OutcomeKind, RtcError


def record(number: int, text: str = "STOW LEFT-ARM") -> m.CommandRecord:
    now = time.monotonic()
    return m.CommandRecord(
        command=f"C-{number}",
        text=text,
        source="operator",
        request=str(number),
        accepted_at_s=now - 2.0,
        phase=m.Phase.ENDED,
        outcome=Outcome(kind=OutcomeKind.SUCCEEDED),
        ended_at_s=now,
    )


def left_behind(directory: Path, records: list[m.CommandRecord]) -> Path:
    directory.mkdir(parents=True, exist_ok=True)
    journal = Journal.open(directory / "journal.db", "run", State())
    journal.append([], records)
    journal.close()
    return directory


def test_the_last_commands_of_a_run_that_has_ended(tmp_path: Path) -> None:
    left_behind(tmp_path, [record(n) for n in range(1, 31)])
    (past,) = runs(tmp_path)

    assert [one.command for one in past.last(3)] == ["C-28", "C-29", "C-30"]
    assert past.command(7) is not None
    assert past.command(31) is None


def test_without_a_cluster_the_journal_in_the_run_directory_answers(tmp_path: Path) -> None:
    left_behind(tmp_path, [record(1), record(2, "STOW RIGHT-ARM")])
    left_behind(tmp_path / PREVIOUS, [record(1, "HOLD LEFT-ARM FOR 1 SEC")])

    last, run = trace.recall("", False, tmp_path, None)
    first, _ = trace.recall("1", False, tmp_path, None)
    earlier, before = trace.recall("C-1", True, tmp_path, None)

    assert run is not None
    assert before is not None
    assert (last.command, last.text) == ("C-2", "STOW RIGHT-ARM")
    assert run.title.startswith("of the run that ended at ")
    assert first.text == "STOW LEFT-ARM"
    assert earlier.text == "HOLD LEFT-ARM FOR 1 SEC"


def test_where_no_cluster_ever_ran_there_is_no_cluster(tmp_path: Path) -> None:
    with pytest.raises(NoCluster):
        trace.recall("", False, tmp_path, None)


def test_a_row_of_the_log_tells_when_and_how_long(tmp_path: Path) -> None:
    past = next(runs(left_behind(tmp_path, [record(1)])))
    row = log.as_row(past.last(1)[0], past)

    assert row["outcome"] == "succeeded"
    assert row["took_s"] == pytest.approx(2.0)
    assert row["at"] is not None


def test_a_run_before_the_machine_was_started_has_no_dates(tmp_path: Path) -> None:
    past = Past(tmp_path / "journal.db", ended_at=time.time() - time.monotonic() - 10.0)

    assert log.as_row(record(1), past)["at"] is None


def test_a_run_ended_when_its_journal_was_written_last(tmp_path: Path) -> None:
    """Of a broker that was killed the last changes are in the write-ahead log."""
    left_behind(tmp_path, [record(1)])
    os.utime(tmp_path / "journal.db", (1000.0, 1000.0))
    assert next(runs(tmp_path)).ended_at == 1000.0
    (tmp_path / "journal.db-wal").write_bytes(b"frames")
    os.utime(tmp_path / "journal.db-wal", (1005.0, 1005.0))
    assert next(runs(tmp_path)).ended_at == 1005.0


def test_a_run_ended_when_its_supervisor_did_however_often_it_is_read(tmp_path: Path) -> None:
    left_behind(tmp_path, [record(1)])
    os.utime(tmp_path / "journal.db", (1000.0, 1000.0))
    next(runs(tmp_path)).last(1)
    assert next(runs(tmp_path)).ended_at == 1000.0
    (tmp_path / "ended.txt").write_text("")
    os.utime(tmp_path / "ended.txt", (1007.0, 1007.0))
    next(runs(tmp_path)).last(1)
    assert next(runs(tmp_path)).ended_at == 1007.0


def test_a_damaged_journal_is_named(tmp_path: Path) -> None:
    (tmp_path / "journal.db").write_bytes(b"this is not a database, whatever its name says")
    (past,) = runs(tmp_path)

    with pytest.raises(RtcError, match=r"journal\.db cannot be read"):
        past.last(1)
