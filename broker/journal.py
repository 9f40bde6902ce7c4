"""The write-ahead journal: every event the Decision Unit hears, before its effects go out (invariant 9).

One row per turn of the broker's loop holds that turn's events as one MessagePack list, in one SQLite transaction
(WAL, so a commit is some microseconds and a killed process loses nothing that was committed). A snapshot of the
whole state now and then lets the events before it go, so the journal stays bounded. The stories of ended commands
are kept beside it, the newest `STORIES_KEPT` of them.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

from broker.events import AnyEvent, Event
from broker.state import State
from rtc import wire
from rtc.messages import CommandRecord

STORIES_KEPT = 20_000
SCHEMA = """
CREATE TABLE IF NOT EXISTS about (key TEXT PRIMARY KEY, value TEXT);
CREATE TABLE IF NOT EXISTS turns (n INTEGER PRIMARY KEY, events BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS snapshot (one INTEGER PRIMARY KEY CHECK (one = 1), n INTEGER, state BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS stories (n INTEGER PRIMARY KEY, command TEXT UNIQUE, record BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS programs (digest TEXT PRIMARY KEY, body BLOB NOT NULL);
"""

read_events = wire.decoder(list[AnyEvent])
read_state = wire.decoder(State)
read_record = wire.decoder(CommandRecord)


class Journal:
    def __init__(self, db: sqlite3.Connection) -> None:
        self.db = db
        self.turns_since_snapshot = 0

    @staticmethod
    def open(path: Path, run: str, first: State) -> Journal:
        """Open or make the journal of this run; what another run left there is not continued. `first` is the state
        a new run begins with."""
        journal = Journal(sqlite3.connect(path, isolation_level=None))
        db = journal.db
        db.execute("PRAGMA journal_mode=WAL")
        db.execute("PRAGMA synchronous=NORMAL")
        db.executescript(SCHEMA)
        before = db.execute("SELECT value FROM about WHERE key = 'run'").fetchone()
        if before is None or before[0] != run:
            with journal.transaction():
                for table in ("turns", "snapshot", "stories", "programs", "about"):
                    db.execute(f"DELETE FROM {table}")
                db.execute("INSERT INTO about VALUES ('run', ?)", (run,))
            journal.snapshot(first)
        return journal

    @staticmethod
    def read_only(path: Path) -> Journal:
        """For looking at a journal, also while its broker writes it."""
        return Journal(sqlite3.connect(f"file:{path}?mode=ro", uri=True, isolation_level=None))

    def transaction(self) -> sqlite3.Connection:
        self.db.execute("BEGIN")
        return self.db  # as a context manager: commits, or rolls back on an exception

    def append(self, events: list[Event], stories: list[CommandRecord]) -> None:
        """One turn: its events and the stories of the commands that ended in it, all or nothing."""
        with self.transaction():
            self.db.execute("INSERT INTO turns (events) VALUES (?)", (wire.encode(events),))
            if stories:
                rows = [(story.command, wire.encode(story)) for story in stories]
                self.db.executemany("INSERT OR REPLACE INTO stories (command, record) VALUES (?, ?)", rows)
        self.turns_since_snapshot += 1

    def snapshot(self, state: State) -> None:
        """Keep the state as it is now, and forget the events that led there."""
        with self.transaction():
            last = self.db.execute("SELECT coalesce(max(n), 0) FROM turns").fetchone()[0]
            self.db.execute("INSERT OR REPLACE INTO snapshot VALUES (1, ?, ?)", (last, wire.encode(state)))
            # The last row stays: SQLite must not number the next turn below the snapshot's.
            self.db.execute("DELETE FROM turns WHERE n < ?", (last,))
            newest = self.db.execute("SELECT coalesce(max(n), 0) FROM stories").fetchone()[0]
            self.db.execute("DELETE FROM stories WHERE n <= ?", (newest - STORIES_KEPT,))
        self.turns_since_snapshot = 0

    def last_snapshot(self) -> tuple[int, State]:
        """(the number of the last turn in it, the state)."""
        n, state = self.db.execute("SELECT n, state FROM snapshot").fetchone()
        return n, read_state(state)

    def turns(self, after: int = 0) -> Iterator[list[Event]]:
        for (events,) in self.db.execute("SELECT events FROM turns WHERE n > ? ORDER BY n", (after,)):
            yield read_events(events)

    def story(self, command: str) -> CommandRecord | None:
        row = self.db.execute("SELECT record FROM stories WHERE command = ?", (command,)).fetchone()
        return None if row is None else read_record(row[0])

    def keep_program(self, digest: str, body: bytes) -> None:
        self.db.execute("INSERT OR IGNORE INTO programs VALUES (?, ?)", (digest, body))

    def programs(self) -> dict[str, bytes]:
        return dict(self.db.execute("SELECT digest, body FROM programs"))

    def close(self) -> None:
        self.db.close()
