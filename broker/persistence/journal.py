"""The write-ahead journal in SQLite: every event of the Decision Unit, before its effects are performed (invariant 7).

One row of the table `turns` holds the events of one batch of the broker's loop, as one MessagePack list. It is written
in one transaction (WAL, so a commit takes some microseconds). A killed process loses nothing that was committed. A
crash of the operating system ends the run, and its journal is not continued, so nothing waits for the disk. Snapshots
of the whole state bound the time of a restart and the size of the journal: events before the last but one are deleted.
The events between the last two are kept so that the jobs of recent commands can be repeated (`rtc replay`).

The table `records` holds the records of about `RECORDS_KEPT` commands that ended last. One row has many of them, which
is cheaper than a row for each. The newest row is written again until it is full. Replay recovers unwritten records:
their events are kept until the next snapshot, which writes the records.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Literal

import msgspec

from broker.decisions.events import AnyEvent, Event
from broker.decisions.state import State
from rtc.protocol import wire
from rtc.protocol.messages import CommandRecord
from rtc.protocol.outcomes import WireError

RECORDS_KEPT = 20_000  # records of ended commands
RECORDS_AT_ONCE, RECORD_BYTES = 64, 16_384  # a row with so many records, or of this size, is full
DELETED_AT_ONCE = 400  # batches; to delete all those of a snapshot together would delay the loop
PAGE_BYTES = 8192  # of a new journal; most batches under load are larger than SQLite's usual page
CHECKPOINT_PAGES = 64  # of the WAL, copied to the database in small parts for the same reason
SNAPSHOTS_KEPT = 2
SNAPSHOT = 3  # layout of state and records; one of another layout is refused, because it would be read wrongly
SCHEMA = """
CREATE TABLE IF NOT EXISTS about (key TEXT PRIMARY KEY, value TEXT);
CREATE TABLE IF NOT EXISTS turns (n INTEGER PRIMARY KEY, events BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS snapshots (n INTEGER PRIMARY KEY, state BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS records (n INTEGER PRIMARY KEY, commands TEXT UNIQUE NOT NULL, records BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS programs (digest TEXT PRIMARY KEY, body BLOB NOT NULL);
"""
# The sign lets SQLite search the index of the commands, which is small, and not the table.
FIND_RECORD = """
SELECT commands, records FROM records WHERE n = (SELECT max(+n) FROM records WHERE instr(' ' || commands || ' ', ?))
"""

read_events = wire.decoder(list[AnyEvent])
read_snapshot = wire.decoder(tuple[Literal[3], State])  # SNAPSHOT, and the state
read_record = wire.decoder(CommandRecord)
read_records = wire.decoder(list[msgspec.Raw])


class Journal:
    def __init__(self, db: sqlite3.Connection) -> None:
        self.db = db
        self.written: Callable[[int], None] = lambda batch: None  # called with the number of each written batch
        self.events_since_snapshot = 0
        self._row = 1  # number of the first record of the newest row, in order of their ends
        self._records: dict[str, CommandRecord] = {}  # of that row
        self._unwritten = False  # the row lacks some of them
        self._forget_before = 0  # batches that a snapshot has made unnecessary

    @staticmethod
    def open(path: Path, run: str, first: State) -> Journal:
        """Open or make the journal of this run; the journal of another run is not continued. `first` is the initial
        state of a new run."""
        journal = Journal(sqlite3.connect(path, isolation_level=None))
        db = journal.db
        db.execute(f"PRAGMA page_size={PAGE_BYTES}")
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
        for row, commands in db.execute("SELECT n, commands FROM records ORDER BY n DESC LIMIT 1"):
            journal._row = row + len(commands.split())
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
            self._add_records(records)

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
        """Write the records that a replay has made, but those that were written before."""
        written = {name for (names,) in self.db.execute("SELECT commands FROM records") for name in names.split()}
        for record in records:
            if record.command not in written:
                self._add_records([record])
        self._write_records()

    def _add_records(self, records: list[CommandRecord]) -> None:
        self._records.update((record.command, record) for record in records)
        self._unwritten = True
        if len(self._records) >= RECORDS_AT_ONCE:
            self._write_records()

    def _write_records(self) -> None:
        if not self._unwritten:
            return
        commands, body = " ".join(self._records), wire.encode([*self._records.values()])
        following = self._row + len(self._records)
        with self.transaction():
            self.db.execute("INSERT OR REPLACE INTO records VALUES (?, ?, ?)", (self._row, commands, body))
            self.db.execute("DELETE FROM records WHERE n < ?", (following - RECORDS_KEPT,))
        self._unwritten = False
        if len(self._records) >= RECORDS_AT_ONCE or len(body) >= RECORD_BYTES:
            self._row, self._records = following, {}

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
        row = self.db.execute(FIND_RECORD, (f" {command} ",)).fetchone()
        if row is None or command not in (names := row[0].split()):
            return None
        return read_record(read_records(row[1])[names.index(command)])

    def keep_program(self, digest: str, body: bytes) -> None:
        self.db.execute("INSERT OR IGNORE INTO programs VALUES (?, ?)", (digest, body))

    def programs(self) -> dict[str, bytes]:
        return dict(self.db.execute("SELECT digest, body FROM programs"))

    def close(self) -> None:
        self._write_records()
        self.db.close()
