"""Damaged database files: rename such a file, so that its process can start with an empty one and report it.

A full disk or a failing read is not damage: it may be temporary, and the file is intact.
"""

from __future__ import annotations

import contextlib
import sqlite3
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

from rtc.protocol.outcomes import WireError

DAMAGE = {11, 26}  # SQLITE_CORRUPT, SQLITE_NOTADB
STARTS = 2  # failed attempts before the file is set aside
SIDE_FILES = ("-wal", "-shm")

Opened = TypeVar("Opened")


def damaged(error: BaseException) -> bool:
    """Whether this error means a file that can never be read again."""
    if isinstance(error, sqlite3.DatabaseError):
        return getattr(error, "sqlite_errorcode", 0) & 0xFF in DAMAGE
    return isinstance(error, WireError)  # a row of an unknown format


def set_aside(path: Path) -> Path:
    """Rename a database with its side files; its new name."""
    aside = path.with_name(f"{path.name}.damaged-{time.strftime('%Y%m%d-%H%M%S')}")
    for suffix in ("", *SIDE_FILES):
        with contextlib.suppress(FileNotFoundError):
            path.with_name(path.name + suffix).rename(aside.with_name(aside.name + suffix))
    return aside


def open_or_set_aside(path: Path, open_it: Callable[[], Opened], note: Callable[[str], object]) -> Opened:
    """The result of `open_it`; if the file at `path` is damaged, set it aside and open an empty one.

    `note` receives the reason in words. Other errors of `open_it` are raised.
    """
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
    """Set the file aside if it is found damaged inside the block; the error is raised again."""
    try:
        yield
    except sqlite3.DatabaseError as error:
        if damaged(error):
            note(f"{path.name} is damaged ({error}); it is kept as {set_aside(path).name}")
        raise
