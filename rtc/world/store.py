"""The store of the world database: present facts, their history, and the jobs that wrote them. SQLite in WAL mode.

    facts    key, value, validity, version, source, at_s, spread    present facts
    history  the same, one row per key and version                  never changed, never deleted
    commits  job, version                                           so that a job writes only once

Values are JSON text, readable by any tool. One thread, one connection. The writer calls `save` once per loop iteration
and answers after it, so that each acknowledged row survives `kill -9`.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path

import msgspec

from rtc.protocol.messages import Fact, Validity, WorldChange
from rtc.world.model import World, changed

SCHEMA = """
CREATE TABLE IF NOT EXISTS facts (key TEXT PRIMARY KEY, value TEXT, validity TEXT, version INTEGER,
                                  source TEXT, at_s REAL, spread TEXT);
CREATE TABLE IF NOT EXISTS history (key TEXT, value TEXT, validity TEXT, version INTEGER, source TEXT, at_s REAL,
                                    spread TEXT, PRIMARY KEY (key, version)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS commits (job TEXT PRIMARY KEY, version INTEGER) WITHOUT ROWID;
"""
COLUMNS = "key, value, validity, version, source, at_s, spread"
ROW = f"({COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?)"
HISTORY_MAX = 1000  # maximum number of facts in one answer
Row = tuple[str, str, str, int, str, float, str | None]


class Store:
    """`version` and `facts` are the present state, in memory. The file is at most one `save` behind."""

    def __init__(self, path: Path | str) -> None:
        self.saved: Callable[[int], object] = lambda version: None  # called with each version that is on disk
        self._db = sqlite3.connect(path, isolation_level=None)  # transactions are explicit
        self._db.execute("PRAGMA journal_mode=WAL")
        self._db.execute("PRAGMA synchronous=NORMAL")  # safe against a killed process, not against power loss
        self._db.executescript(SCHEMA)
        self.facts: dict[str, Fact] = {row[0]: _fact(row) for row in self._db.execute(f"SELECT {COLUMNS} FROM facts")}
        (self.version,) = self._db.execute("SELECT coalesce(max(version), 0) FROM commits").fetchone()

    def committed(self, job: str) -> int | None:
        """The version that this job wrote; None if it wrote none."""
        row = self._db.execute("SELECT version FROM commits WHERE job = ?", (job,)).fetchone()
        return None if row is None else row[0]

    def write(self, job: str, changes: Iterable[WorldChange], source: str, at_s: float) -> int:
        """Applies changes as one new version, and returns it. On disk after the next `save`."""
        if not self._db.in_transaction:
            self._db.execute("BEGIN")
        self.version += 1
        written: dict[str, Fact] = {}
        for change in changes:
            before = written.get(change.key, self.facts.get(change.key))
            written[change.key] = changed(before, change, self.version, source, at_s)
        rows = [_row(fact) for fact in written.values()]
        self._db.executemany(f"INSERT OR REPLACE INTO facts {ROW}", rows)
        self._db.executemany(f"INSERT INTO history {ROW}", rows)
        self._db.execute("INSERT INTO commits VALUES (?, ?)", (job, self.version))
        self.facts.update(written)
        return self.version

    def save(self) -> None:
        """Commits the open transaction, if there is one."""
        if self._db.in_transaction:
            self._db.execute("COMMIT")
            self.saved(self.version)

    def history(self, key: str, limit: int) -> list[Fact]:
        """The past and present facts of this key, newest first; at most HISTORY_MAX."""
        rows = self._db.execute(
            f"SELECT {COLUMNS} FROM history WHERE key = ? ORDER BY version DESC LIMIT ?",
            (key, min(max(0, limit), HISTORY_MAX)),
        )
        return [_fact(row) for row in rows]

    def close(self) -> None:
        self.save()
        self._db.close()


def world_at(path: Path, version: int) -> World:
    """The world as it was at a version, from the history in a file, which another process may be writing."""
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as db:
        # SQLite takes the other columns from the row with the maximum.
        columns = COLUMNS.replace("version", "max(version)")
        rows = db.execute(f"SELECT {columns} FROM history WHERE version <= ? GROUP BY key", (version,))
        return World(version, {row[0]: _fact(row) for row in rows})


def _row(fact: Fact) -> Row:
    value = msgspec.json.encode(fact.value).decode()
    spread = None if fact.spread is None else msgspec.json.encode(fact.spread).decode()
    return (fact.key, value, fact.validity.value, fact.version, fact.source, fact.at_s, spread)


def _fact(row: Row) -> Fact:
    key, value, validity, version, source, at_s, spread = row
    return Fact(
        key=key,
        value=msgspec.json.decode(value),
        validity=Validity(validity),
        version=version,
        source=source,
        at_s=at_s,
        spread=None if spread is None else msgspec.json.decode(spread),
    )
