"""The write-ahead journal: every event of the Decision Unit, before its effects go out (invariant 7).

One row per turn of the broker's loop holds that turn's events as one MessagePack list, in one SQLite transaction
(WAL, so a commit is some microseconds). A killed process loses nothing that was committed; a crash of the operating
system ends the run, whose journal nobody continues, so nothing waits for the disk. A snapshot of the whole state now
and then lets the events before it go, so the journal stays bounded, and so does the time to replay it.

The stories of commands are kept beside it, of the `STORIES_KEPT` that ended last, however old they became. They are
written some at a time: until a snapshot takes the place of the events, whoever replays these is told the stories again.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Literal

from broker.decisions.events import AnyEvent, Event
from broker.decisions.state import State
from rtc.protocol import wire
from rtc.protocol.messages import CommandRecord
from rtc.protocol.outcomes import WireError

STORIES_KEPT = 20_000
STORIES_AT_ONCE = 64
FORGOTTEN_AT_ONCE = 400  # turns: forgetting all of a snapshot at once would hold up what comes meanwhile
CHECKPOINT_PAGES = 128  # of the WAL, brought home little by little for the same reason
SNAPSHOT = 2  # layout of the stored state; one of another layout is refused, because it would be read wrongly
SCHEMA = """
CREATE TABLE IF NOT EXISTS about (key TEXT PRIMARY KEY, value TEXT);
CREATE TABLE IF NOT EXISTS turns (n INTEGER PRIMARY KEY, events BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS snapshot (one INTEGER PRIMARY KEY CHECK (one = 1), n INTEGER, state BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS stories (ended INTEGER PRIMARY KEY, n INTEGER UNIQUE NOT NULL, record BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS programs (digest TEXT PRIMARY KEY, body BLOB NOT NULL);
"""
# One that is told again keeps its place.
KEEP_STORY = """
INSERT INTO stories (n, record) VALUES (?, ?) ON CONFLICT (n) DO UPDATE SET record = excluded.record;
"""

read_events = wire.decoder(list[AnyEvent])
read_snapshot = wire.decoder(tuple[Literal[2], State])  # SNAPSHOT, and the state
read_record = wire.decoder(CommandRecord)


class Journal:
    def __init__(self, db: sqlite3.Connection) -> None:
        self.db = db
        self.written: Callable[[int], None] = lambda turn: None  # hears the number of every turn that is written
        self.events_since_snapshot = 0
        self._stories: dict[str, CommandRecord] = {}  # not written yet
        self._forget_before = 0  # turns that a snapshot has made needless

    @staticmethod
    def open(path: Path, run: str, first: State) -> Journal:
        """Open or make the journal of this run; what another run left there is not continued. `first` is the state
        a new run begins with."""
        journal = Journal(sqlite3.connect(path, isolation_level=None))
        db = journal.db
        db.execute("PRAGMA journal_mode=WAL")
        db.execute("PRAGMA synchronous=OFF")
        db.execute(f"PRAGMA wal_autocheckpoint={CHECKPOINT_PAGES}")
        db.executescript(SCHEMA)
        before = db.execute("SELECT value FROM about WHERE key = 'run'").fetchone()
        if before is None or before[0] != run:
            with journal.transaction():
                for table in ("turns", "snapshot", "stories", "programs", "about"):
                    db.execute(f"DROP TABLE {table}")  # another release's may look different
                for statement in SCHEMA.split(";"):
                    db.execute(statement)
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
        """One turn: its events, and the stories of the commands that ended in it."""
        turn = self.db.execute("INSERT INTO turns (events) VALUES (?)", (wire.encode(events),)).lastrowid
        self.written(turn or 0)
        self.events_since_snapshot += len(events)
        if stories:
            self._stories.update((story.command, story) for story in stories)
            if len(self._stories) >= STORIES_AT_ONCE:
                self._write_stories()

    def snapshot(self, state: State) -> None:
        """Keep the state as it is now; the events that led there are needed no longer."""
        self._write_stories()
        with self.transaction():
            last = self.db.execute("SELECT coalesce(max(n), 0) FROM turns").fetchone()[0]
            self.db.execute("INSERT OR REPLACE INTO snapshot VALUES (1, ?, ?)", (last, wire.encode((SNAPSHOT, state))))
        self._forget_before = last  # that one stays: SQLite must not number the next turn below the snapshot's
        self.events_since_snapshot = 0

    def tidy(self) -> None:
        """Now and then, when there is time: write what is not written yet, forget some of what is not needed."""
        self._write_stories()
        some = "SELECT n FROM turns WHERE n < ? ORDER BY n LIMIT ?"
        self.db.execute(f"DELETE FROM turns WHERE n IN ({some})", (self._forget_before, FORGOTTEN_AT_ONCE))

    def keep_stories(self, stories: Iterable[CommandRecord]) -> None:
        """Those that a replay has told: some may have been written already."""
        self._stories.update((story.command, story) for story in stories)
        self._write_stories()

    def _write_stories(self) -> None:
        stories, self._stories = self._stories, {}
        if stories:
            rows = [(number(story.command), wire.encode(story)) for story in stories.values()]
            with self.transaction():
                self.db.executemany(KEEP_STORY, rows)
                newest = self.db.execute("SELECT max(ended) FROM stories").fetchone()[0]
                self.db.execute("DELETE FROM stories WHERE ended <= ?", (newest - STORIES_KEPT,))

    def last_snapshot(self) -> tuple[int, State]:
        """(the number of the last turn in it, the state)."""
        n, state = self.db.execute("SELECT n, state FROM snapshot").fetchone()
        self._forget_before = n
        try:
            return n, read_snapshot(state)[1]
        except WireError as error:
            raise WireError(f"its snapshot is damaged or of another release: {error}") from error

    def last_turn(self) -> int:
        """The number of the last turn; 0 of a new journal."""
        newest: int = self.db.execute("SELECT coalesce(max(n), 0) FROM turns").fetchone()[0]
        return max(newest, self._forget_before)

    def turns(self, after: int = 0) -> Iterator[list[Event]]:
        for (events,) in self.db.execute("SELECT events FROM turns WHERE n > ? ORDER BY n", (after,)):
            yield read_events(events)

    def story(self, command: str) -> CommandRecord | None:
        if command in self._stories:
            return self._stories[command]
        row = self.db.execute("SELECT record FROM stories WHERE n = ?", (number(command),)).fetchone()
        return None if row is None else read_record(row[0])

    def keep_program(self, digest: str, body: bytes) -> None:
        self.db.execute("INSERT OR IGNORE INTO programs VALUES (?, ?)", (digest, body))

    def programs(self) -> dict[str, bytes]:
        return dict(self.db.execute("SELECT digest, body FROM programs"))

    def close(self) -> None:
        self._write_stories()
        self.db.close()


def number(command: str) -> int:
    """7 of C-7; -1 for what is no command's name."""
    number = command.removeprefix("C-")
    return int(number) if number.isascii() and number.isdigit() and len(number) < 18 else -1
