"""Databases whose files are damaged are put aside; a full disk is no damage."""

from __future__ import annotations

import sqlite3

import pytest

from broker.decisions.state import State
from broker.persistence.journal import Journal
from broker.persistence.replay import replay
from rtc.protocol import wire
from rtc.runtime.damaged_database import damaged, open_or_set_aside
from rtc.world.store import Store


def journal(path):
    opened = Journal.open(path, "r", State())
    return opened, *replay(opened)


def fill_journal(path):
    opened = Journal.open(path, "r", State())
    for n in range(300):
        opened.keep_program(f"{n}", b"x" * 1000)
    opened.close()


def fill_store(path):
    store = Store(path)
    store._db.execute("CREATE TABLE padding (x)")
    store._db.executemany("INSERT INTO padding VALUES (?)", [("x" * 1000,)] * 100)
    store.close()


def cut(path):
    with open(path, "r+b") as file:
        file.truncate(path.stat().st_size // 2)


def overwrite(path):
    with open(path, "r+b") as file:
        file.write(b"noise" * 2000)


@pytest.mark.parametrize("damage", [cut, overwrite])
@pytest.mark.parametrize(("fill", "opener"), [(fill_journal, journal), (fill_store, Store)], ids=["journal", "world"])
def test_a_damaged_file_is_put_aside_and_begun_anew(tmp_path, fill, opener, damage):
    path = tmp_path / "some.db"
    fill(path)
    damage(path)
    notes = []
    open_or_set_aside(path, lambda: opener(path), notes.append)
    (aside,) = tmp_path.glob("some.db.damaged-*[0-9]")
    assert aside.name in notes[0]
    assert "some.db was damaged" in notes[0]
    assert path.exists()


def test_a_row_that_is_no_event_is_damage(tmp_path):
    path = tmp_path / "journal.db"
    opened = Journal.open(path, "r", State())
    opened.db.execute("INSERT INTO turns (events) VALUES (?)", (b"noise",))
    opened.close()
    notes = []
    _, state, _ = open_or_set_aside(path, lambda: journal(path), notes.append)
    assert state == State()
    assert len(notes) == 1


def test_a_snapshot_of_another_layout_is_put_aside_rather_than_read_wrongly(tmp_path):
    path = tmp_path / "journal.db"
    opened = Journal.open(path, "r", State())
    opened.db.execute("UPDATE snapshots SET state = ?", (wire.encode(State(accepted=7)),))
    opened.close()
    notes = []
    _, state, _ = open_or_set_aside(path, lambda: journal(path), notes.append)
    assert state == State()
    assert "another release" in notes[0]


def test_a_full_disk_is_no_damage(tmp_path):
    path = tmp_path / "some.db"
    fill_journal(path)

    def full():
        db = sqlite3.connect(path)
        db.execute("PRAGMA max_page_count = 1")
        db.execute("CREATE TABLE t (x)")
        db.executemany("INSERT INTO t VALUES (?)", [("x" * 5000,)] * 1000)

    with pytest.raises(sqlite3.OperationalError, match="full") as caught:
        open_or_set_aside(path, full, print)
    assert not damaged(caught.value)
    assert [file.name for file in tmp_path.glob("*.damaged-*")] == []
