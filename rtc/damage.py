"""A database whose file is damaged: put aside, so that its process can begin anew and say so.

A full disk or a failing read is not damage: it may pass, and what lies there is whole.
"""

from __future__ import annotations

import contextlib
import sqlite3
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

from rtc.outcomes import WireError

DAMAGE = {11, 26}  # SQLITE_CORRUPT, SQLITE_NOTADB
STARTS = 2  # so many failed, and the file is put aside
SIDE_FILES = ("-wal", "-shm")

Opened = TypeVar("Opened")


def damaged(error: BaseException) -> bool:
    """Whether this error tells of a file that no later try can read."""
    if isinstance(error, sqlite3.DatabaseError):
        return getattr(error, "sqlite_errorcode", 0) & 0xFF in DAMAGE
    return isinstance(error, WireError)  # a row of another shape


def set_aside(path: Path) -> Path:
    """Rename a database with its side files; its new name."""
    aside = path.with_name(f"{path.name}.damaged-{time.strftime('%Y%m%d-%H%M%S')}")
    for suffix in ("", *SIDE_FILES):
        with contextlib.suppress(FileNotFoundError):
            path.with_name(path.name + suffix).rename(aside.with_name(aside.name + suffix))
    return aside


def open_or_set_aside(path: Path, open_it: Callable[[], Opened], note: Callable[[str], object]) -> Opened:
    """What `open_it` makes of the file at `path`; of a damaged file, what it makes of none. `note` gets the reason in
    words. Raises what `open_it` raises otherwise."""
    for _ in range(STARTS):
        try:
            return open_it()
        except (sqlite3.DatabaseError, WireError) as error:
            if not damaged(error):
                raise
            last = error
    note(f"{path.name} was damaged ({last}); it is kept as {set_aside(path).name}")
    return open_it()


@contextlib.contextmanager
def put_aside_when_damaged(path: Path, note: Callable[[str], object]) -> Iterator[None]:
    """For the time after the start: a file found damaged then is put aside before the process ends."""
    try:
        yield
    except sqlite3.DatabaseError as error:
        if damaged(error):
            note(f"{path.name} is damaged ({error}); it is kept as {set_aside(path).name}")
        raise
