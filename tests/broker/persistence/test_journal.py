"""What is journalled is decided again after a restart, and comes out the same."""

from __future__ import annotations

import msgspec
import pytest

from broker.decisions.decide import decide
from broker.decisions.effects import ReportEnd
from broker.decisions.events import ProgramInstalled
from broker.decisions.state import State
from broker.persistence import replay
from broker.persistence.journal import Journal
from rtc.protocol import wire
from rtc.protocol.messages import WorkerKind
from tests.broker.harness import Harness, go_on, script


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.db"


class Journalled(Harness):
    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        super().__init__()

    def handle(self, what, /, **fields):
        self.now += 0.001
        event = self.event(what, **fields)
        effects = decide(self.state, event)
        self.journal.append([event], [e.record for e in effects if isinstance(e, ReportEnd)])
        return effects


def test_replay_gives_the_state_the_broker_was_in(path):
    s = Journalled(Journal.open(path, "run", State()))
    s.analyzing()
    s.executing(script(resources=("LEFT-ARM",)), hand="LEFT-ARM")
    s.answers("C-1", go_on())
    s.journal.close()
    state, ended = replay.replay(Journal.open(path, "run", State()))
    assert wire.encode(state) == wire.encode(s.state)
    assert list(ended) == ["C-1"]


@pytest.mark.parametrize("with_snapshot", [False, True])
def test_after_a_restart_a_command_has_the_programs_it_began_with(path, with_snapshot):
    s = Journalled(Journal.open(path, "run", State()))
    bodies = {name: s.journal.keep_program(name, name.encode()) for name in ("old", "new")}
    s.handle(ProgramInstalled, kind=WorkerKind.BINDER, digest="old")
    s.executing()
    s.handle(ProgramInstalled, kind=WorkerKind.BINDER, digest="new")
    if with_snapshot:
        s.journal.snapshot(s.state)
    s.journal.close()
    journal = Journal.open(path, "run", State())
    state, _ = replay.replay(journal)
    assert (state.commands["C-1"].programs["binder"], state.programs["binder"]) == ("old", "new")
    assert journal.programs().keys() == bodies.keys()


def test_replay_goes_on_from_a_snapshot(path):
    s = Journalled(Journal.open(path, "run", State()))
    s.executing()
    s.journal.snapshot(s.state)
    s.reports("C-1")
    s.journal.snapshot(s.state)
    s.answers("C-1", go_on())
    s.journal.close()
    journal = Journal.open(path, "run", State())
    journal.last_snapshot()
    journal.tidy()
    assert journal.db.execute("SELECT count(*) FROM turns").fetchone()[0] <= 4  # the journal is bounded
    state, ended = replay.replay(journal)
    assert wire.encode(state) == wire.encode(s.state)
    assert list(ended) == ["C-1"]


def test_another_run_begins_anew(path):
    s = Journalled(Journal.open(path, "run", State()))
    s.executing()
    s.journal.close()
    state, _ = replay.replay(Journal.open(path, "another run", State()))
    assert state == State()


def test_the_story_of_an_ended_command_is_kept(path):
    s = Journalled(Journal.open(path, "run", State()))
    s.analyzing()
    s.answers("C-1", go_on())
    story = s.journal.record("C-1")
    assert story.outcome.kind == "succeeded"
    assert [n.phase.value for n in story.notes][-1] == "ended"
    assert s.journal.record("C-2") is None
    assert s.journal.record("C-" + "9" * 30) is None
    assert s.journal.record("X") is None


def test_a_record_not_written_yet_is_rebuilt_by_the_replay(path):
    s = Journalled(Journal.open(path, "run", State()))
    s.analyzing()
    s.answers("C-1", go_on())
    story = s.journal.record("C-1")
    s.journal.db.close()  # killed
    journal = Journal.open(path, "run", State())
    assert journal.record("C-1") is None
    journal.keep_records(replay.replay(journal)[1].values())
    assert journal.record("C-1") == story
    journal.tidy()
    assert journal.record("C-1") == story


def test_no_more_stories_are_kept_than_the_newest(path, monkeypatch):
    monkeypatch.setattr("broker.persistence.journal.RECORDS_KEPT", 2)
    monkeypatch.setattr("broker.persistence.journal.RECORDS_AT_ONCE", 1)
    s = Journalled(Journal.open(path, "run", State()))
    for n in range(1, 5):
        s.analyzing()
        s.answers(f"C-{n}", go_on())
        s.journal.tidy()
    assert [s.journal.record(f"C-{n}") is not None for n in range(1, 5)] == [False, False, True, True]


def test_the_records_of_many_commands_share_a_row_also_after_a_restart(path, monkeypatch):
    monkeypatch.setattr("broker.persistence.journal.RECORDS_AT_ONCE", 3)
    s = Journalled(Journal.open(path, "run", State()))
    for n in range(1, 8):
        s.analyzing()
        s.answers(f"C-{n}", go_on())
        s.journal.tidy()
    stories = [s.journal.record(f"C-{n}") for n in range(1, 8)]
    s.journal.db.close()  # killed
    journal = Journal.open(path, "run", State())
    journal.keep_records(replay.replay(journal)[1].values())
    rows = journal.db.execute("SELECT commands FROM records ORDER BY n").fetchall()
    assert [names for (names,) in rows] == ["C-1 C-2 C-3", "C-4 C-5 C-6", "C-7"]
    journal.keep_records([msgspec.structs.replace(stories[0], command="C-8")])
    assert [journal.record(f"C-{n}") for n in range(1, 8)] == stories
    assert journal.record("C-8").text == stories[0].text


def test_of_a_command_that_lived_long_the_story_is_kept_as_long_as_any_others(path, monkeypatch):
    monkeypatch.setattr("broker.persistence.journal.RECORDS_KEPT", 2)
    monkeypatch.setattr("broker.persistence.journal.RECORDS_AT_ONCE", 1)
    s = Journalled(Journal.open(path, "run", State()))
    s.executing(script(resources=("LEFT-ARM",)), hand="LEFT-ARM")
    for n in range(2, 6):
        s.analyzing()
        s.answers(f"C-{n}", go_on())
    s.journal.tidy()
    s.reports("C-1")
    s.answers("C-1", go_on())
    s.journal.tidy()
    s.journal.keep_records([s.journal.record("C-5"), s.journal.record("C-1")])  # made again by a replay
    assert [s.journal.record(f"C-{n}") is not None for n in range(1, 6)] == [True, False, False, False, True]
    s.analyzing()
    s.answers("C-6", go_on())
    s.journal.tidy()
    assert [s.journal.record(f"C-{n}") is not None for n in (1, 5, 6)] == [True, False, True]


def test_what_another_run_left_may_look_different(path):
    journal = Journal.open(path, "old run", State())
    journal.db.execute("DROP TABLE records")
    journal.db.execute("CREATE TABLE records (n INTEGER PRIMARY KEY, record BLOB NOT NULL)")
    journal.close()
    s = Journalled(Journal.open(path, "run", State()))
    s.analyzing()
    s.answers("C-1", go_on())
    s.journal.tidy()
    assert s.journal.record("C-1").outcome.kind == "succeeded"


def test_programs_outlive_a_restart(path):
    journal = Journal.open(path, "run", State())
    journal.keep_program("d1", b"body")
    journal.close()
    assert Journal.open(path, "run", State()).programs() == {"d1": b"body"}


def test_the_command_proves_the_same_decisions(path, capsys):
    s = Journalled(Journal.open(path, "run", State()))
    s.analyzing()
    s.answers("C-1", go_on())
    assert replay.main([str(path)]) == 0
    assert capsys.readouterr().out.endswith("same decisions\n")


def test_the_command_finds_a_changed_story(path, capsys):
    s = Journalled(Journal.open(path, "run", State()))
    s.analyzing()
    s.answers("C-1", go_on())
    story = s.journal.record("C-1")
    s.journal.tidy()
    changed = msgspec.structs.replace(story, text="Y")
    s.journal.db.execute("UPDATE records SET records = ?", (wire.encode([changed]),))
    assert replay.main([str(path)]) == 1
    assert "DIFFERENT decisions: C-1" in capsys.readouterr().out


def test_the_command_says_so_when_there_is_nothing_to_decide_again_or_no_journal(path, tmp_path, capsys):
    s = Journalled(Journal.open(path, "run", State()))
    s.analyzing()
    s.answers("C-1", go_on())
    s.journal.snapshot(s.state)
    assert replay.main([str(path)]) == 0
    assert "nothing to decide again" in capsys.readouterr().out
    other = tmp_path / "notes.txt"
    other.write_text("no journal at all, but long enough to be looked at as one" * 20)
    assert replay.main([str(other)]) == 2
    assert "is not a journal" in capsys.readouterr().out
