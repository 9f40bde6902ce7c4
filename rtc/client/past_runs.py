"""Commands of a cluster that has ended, read from the journal that its broker left behind.

Reads the table `records` of `broker/persistence/journal.py` in the file itself, read-only, and needs no process.
Times in a record are CLOCK_MONOTONIC seconds; `Past.wall_s` converts them to Unix time.
"""

from __future__ import annotations

import contextlib
import sqlite3
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import msgspec

from rtc.protocol import wire
from rtc.protocol.messages import CommandRecord
from rtc.protocol.outcomes import RtcError, WireError
from rtc.runtime.settings import LAST_WORDS

JOURNAL = "journal.db"  # in the run directory of a cluster
PREVIOUS = "previous"  # a directory in it: the same of the run before
OLDER = ("previous-2", "previous-3")
RECORDS = "SELECT commands, records FROM records ORDER BY n"

_read = wire.decoder(CommandRecord)
_read_row = wire.decoder(list[msgspec.Raw])


@dataclass(frozen=True)
class Past:
    """The commands of one ended run. `ended_at`: Unix time of its end (s)."""

    journal: Path
    ended_at: float

    def last(self, most: int) -> list[CommandRecord]:
        """The newest commands, oldest first. Raises RtcError when the file cannot be read."""
        records = self._records()
        return [_read(records[n]) for n in sorted(records)[-most:]]

    def command(self, number: int) -> CommandRecord | None:
        """One command by its number. Raises RtcError when the file cannot be read."""
        record = self._records().get(number)
        return None if record is None else _read(record)

    @property
    def title(self) -> str:
        return f"of the run that ended at {clock_time(self.ended_at)}"

    def wall_s(self, at_s: float) -> float | None:
        """The Unix time of a monotonic time in a record; None if the machine was restarted since."""
        boot = time.time() - time.monotonic()
        return boot + at_s if self.ended_at >= boot else None

    def _records(self) -> dict[int, msgspec.Raw]:
        """Command number -> encoded record."""
        try:
            with contextlib.closing(sqlite3.connect(f"file:{self.journal}?mode=ro", uri=True)) as db:
                rows = [(names.split(), _read_row(records)) for names, records in db.execute(RECORDS)]
        except (sqlite3.Error, WireError) as error:
            raise RtcError(f"the journal {self.journal} cannot be read: {error}") from None
        return {int(name.removeprefix("C-")): one for row in rows for name, one in zip(*row, strict=True)}


def runs(run_dir: Path) -> Iterator[Past]:
    """The journals in a run directory, newest first; the first may belong to a running cluster."""
    for name in (".", PREVIOUS, *OLDER):
        with contextlib.suppress(OSError):
            yield Past(run_dir / name / JOURNAL, _ended_at(run_dir / name))


def _ended_at(directory: Path) -> float:
    """The Unix time at which the supervisor wrote its last file; without one the last change of the journal. The
    write-ahead log has the last changes of a killed broker. An empty one was made by a reader, after the end."""
    journal, last_words = directory / JOURNAL, directory / LAST_WORDS
    changed = journal.stat().st_mtime
    if last_words.exists():
        return last_words.stat().st_mtime
    log = journal.with_name(f"{journal.name}-wal")
    return max(changed, log.stat().st_mtime) if log.exists() and log.stat().st_size else changed


def clock_time(at: float) -> str:
    """A Unix time for people, local: 14:03:22 of today, else with the date."""
    moment = datetime.fromtimestamp(at)
    return moment.strftime("%H:%M:%S" if moment.date() == datetime.now().date() else "%Y-%m-%d %H:%M:%S")
