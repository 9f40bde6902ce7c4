"""The write-ahead journal in SQLite: every event of the Decision Unit, before its effects are performed (invariant 7).

One row of the table `turns` holds the events of one batch of the broker's loop, as one MessagePack list. It is written
in one transaction (WAL, so a commit takes some microseconds). A killed process loses nothing that was committed. A
crash of the operating system ends the run, and its journal is not continued, so nothing waits for the disk. Snapshots
of the whole state bound the time of a restart and the size of the journal: events before the last but one are deleted.
The events between the last two are kept so that the jobs of recent commands can be repeated (`rtc replay`).

The table `records` holds the records of the `RECORDS_KEPT` commands that ended last. They are written some at a time.
Unwritten records are recovered by replay: their events are kept until the next snapshot, which writes the records.
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

RECORDS_KEPT = 20_000  # maximum number of records of ended commands
RECORDS_AT_ONCE = 64  # unwritten records that are written together
DELETED_AT_ONCE = 400  # batches; to delete all those of a snapshot together would delay the loop
CHECKPOINT_PAGES = 128  # of the WAL, copied to the database in small parts for the same reason
SNAPSHOTS_KEPT = 2
SNAPSHOT = 2  # layout of the stored state; one of another layout is refused, because it would be read wrongly
SCHEMA = """
CREATE TABLE IF NOT EXISTS about (key TEXT PRIMARY KEY, value TEXT);
CREATE TABLE IF NOT EXISTS turns (n INTEGER PRIMARY KEY, events BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS snapshots (n INTEGER PRIMARY KEY, state BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS records (ended INTEGER PRIMARY KEY, n INTEGER UNIQUE NOT NULL, record BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS programs (digest TEXT PRIMARY KEY, body BLOB NOT NULL);
"""
# A record that is written again keeps its place.
KEEP_RECORD = """
INSERT INTO records (n, record) VALUES (?, ?) ON CONFLICT (n) DO UPDATE SET record = excluded.record;
"""

read_events = wire.decoder(list[AnyEvent])
read_snapshot = wire.decoder(tuple[Literal[2], State])  # SNAPSHOT, and the state
read_record = wire.decoder(CommandRecord)


class Journal:
    def __init__(self, db: sqlite3.Connection) -> None:
        self.db = db
        self.written: Callable[[int], None] = lambda batch: None  # called with the number of each written batch
        self.events_since_snapshot = 0
        self._records: dict[str, CommandRecord] = {}  # not written yet
        self._forget_before = 0  # batches that a snapshot has made unnecessary

    @staticmethod
    def open(path: Path, run: str, first: State) -> Journal:
        """Open or make the journal of this run; the journal of another run is not continued. `first` is the initial
        state of a new run."""
        journal = Journal(sqlite3.connect(path, isolation_level=None))
        db = journal.db
        db.execute("PRAGMA journal_mode=WAL")
        db.execute("PRAGMA synchronous=OFF")
        db.execute("PRAGMA secure_delete=OFF")
        db.execute(f"PRAGMA wal_autocheckpoint={CHECKPOINT_PAGES}")
        db.executescript(SCHEMA)
        before = db.execute("SELECT value FROM about WHERE key = 'run'").fetchone()
        if before is None or before[0] != run:
            with journal.transaction():
                for table in ("turns", "snapshots", "records", "programs", "about"):
                    db.execute(f"DROP TABLE {table}")  # another release may have another schema
                for statement in SCHEMA.split(";"):
                    db.execute(statement)
                db.execute("INSERT INTO about VALUES ('run', ?)", (run,))
            journal.snapshot(first)
        return journal

    @staticmethod
    def read_only(path: Path, *, one_thread: bool = True) -> Journal:
        """For reading a journal, also while its broker writes it. `one_thread`: SQLite refuses other threads."""
        file = f"file:{path}?mode=ro"
        return Journal(sqlite3.connect(file, uri=True, isolation_level=None, check_same_thread=one_thread))

    def transaction(self) -> sqlite3.Connection:
        self.db.execute("BEGIN")
        return self.db  # as a context manager: commits, or rolls back on an exception

    def append(self, events: list[Event], records: list[CommandRecord]) -> None:
        """Write one batch: its events, and the records of the commands that ended in it."""
        batch = self.db.execute("INSERT INTO turns (events) VALUES (?)", (wire.encode(events),)).lastrowid
        self.written(batch or 0)
        self.events_since_snapshot += len(events)
        if records:
            self._records.update((record.command, record) for record in records)
            if len(self._records) >= RECORDS_AT_ONCE:
                self._write_records()

    def snapshot(self, state: State) -> None:
        """Write the state as it is now; a restart does not need the events up to now any more."""
        self._write_records()
        with self.transaction():
            last = self.db.execute("SELECT coalesce(max(n), 0) FROM turns").fetchone()[0]
            self.db.execute("INSERT OR REPLACE INTO snapshots VALUES (?, ?)", (last, wire.encode((SNAPSHOT, state))))
            self.db.execute(
                "DELETE FROM snapshots WHERE n NOT IN (SELECT n FROM snapshots ORDER BY n DESC LIMIT ?)",
                (SNAPSHOTS_KEPT,),
            )
        self._forget_before = self._oldest_snapshot()  # its batch stays: SQLite numbers the next one above it
        self.events_since_snapshot = 0

    def _oldest_snapshot(self) -> int:
        oldest: int = self.db.execute("SELECT min(n) FROM snapshots").fetchone()[0]
        return oldest

    def tidy(self) -> None:
        """Write unwritten records and delete some unnecessary batches; call it periodically."""
        self._write_records()
        some = "SELECT n FROM turns WHERE n < ? ORDER BY n LIMIT ?"
        self.db.execute(f"DELETE FROM turns WHERE n IN ({some})", (self._forget_before, DELETED_AT_ONCE))

    def keep_records(self, records: Iterable[CommandRecord]) -> None:
        """Write the records that a replay has made; some may have been written before."""
        self._records.update((record.command, record) for record in records)
        self._write_records()

    def _write_records(self) -> None:
        records, self._records = self._records, {}
        if records:
            rows = [(number(record.command), wire.encode(record)) for record in records.values()]
            with self.transaction():
                self.db.executemany(KEEP_RECORD, rows)
                newest = self.db.execute("SELECT max(ended) FROM records").fetchone()[0]
                self.db.execute("DELETE FROM records WHERE ended <= ?", (newest - RECORDS_KEPT,))

    def last_snapshot(self) -> tuple[int, State]:
        """(number of its last batch, state)."""
        self._forget_before = self._oldest_snapshot()
        return self._snapshot("max")

    def first_snapshot(self) -> tuple[int, State]:
        """The one before the oldest events that are kept for a repetition."""
        return self._snapshot("min")

    def _snapshot(self, which: Literal["min", "max"]) -> tuple[int, State]:
        """Raises WireError if it is damaged or of another release."""
        chosen = f"SELECT n, state FROM snapshots WHERE n = (SELECT {which}(n) FROM snapshots)"
        n, state = self.db.execute(chosen).fetchone()
        try:
            return n, read_snapshot(state)[1]
        except WireError as error:
            raise WireError(f"its snapshot is damaged or of another release: {error}") from error

    def last_batch(self) -> int:
        """The number of the last batch; 0 in a new journal."""
        newest: int = self.db.execute("SELECT coalesce(max(n), 0) FROM turns").fetchone()[0]
        return max(newest, self.db.execute("SELECT max(n) FROM snapshots").fetchone()[0])

    def batches(self, after: int = 0) -> Iterator[list[Event]]:
        for (events,) in self.db.execute("SELECT events FROM turns WHERE n > ? ORDER BY n", (after,)):
            yield read_events(events)

    def record(self, command: str) -> CommandRecord | None:
        if command in self._records:
            return self._records[command]
        row = self.db.execute("SELECT record FROM records WHERE n = ?", (number(command),)).fetchone()
        return None if row is None else read_record(row[0])

    def keep_program(self, digest: str, body: bytes) -> None:
        self.db.execute("INSERT OR IGNORE INTO programs VALUES (?, ?)", (digest, body))

    def programs(self) -> dict[str, bytes]:
        return dict(self.db.execute("SELECT digest, body FROM programs"))

    def close(self) -> None:
        self._write_records()
        self.db.close()


def number(command: str) -> int:
    """7 for C-7; -1 for other text."""
    number = command.removeprefix("C-")
    return int(number) if number.isascii() and number.isdigit() and len(number) < 18 else -1
