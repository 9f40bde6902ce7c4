"""The supervision of the run directory: deleted files are restored; without the directory or lock the cluster ends.

Cleaners of temporary files delete files that were not used for days, and a logout removes the user's runtime directory.
The files for a halt, for `rtc down` and for the next client must exist as long as the cluster runs. The processes that
bind sockets restore these themselves (`rtc.runtime.process`).
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import socket
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from rtc.protocol.outcomes import ClusterError
from rtc.runtime.process import Every
from rtc.runtime.settings import LOCK

TOUCH_S = 3600.0  # period of touching all files; cleaners spare files younger than a day


class Directory:
    """`lock`: descriptor of the locked file LOCK in `run_dir`; `files`: name -> function that writes the file again."""

    def __init__(self, run_dir: Path, lock: int, files: Mapping[str, Callable[[], object]]) -> None:
        self._path, self._lock, self._files = run_dir, lock, files
        self._is = _identity(run_dir)
        self._touch = Every(TOUCH_S)

    def look(self, now_s: float) -> tuple[list[str], str]:
        """(names of the files written again, reason why the cluster must end or ""). To be called every second."""
        if _identity(self._path) != self._is:
            return [], f"{self._path} was renamed or removed"
        if not self._holds_lock():
            return [], f"another supervisor holds {self._path / LOCK}"
        again = [name for name, write in self._files.items() if self._write_again(name, write)]
        if self._touch.due(now_s):
            self._touch_all()
        return again, ""

    def ours(self) -> bool:
        """True if the path is still the original directory, with our lock."""
        return _identity(self._path) == self._is and self._holds_lock()

    def _write_again(self, name: str, write: Callable[[], object]) -> bool:
        if (self._path / name).exists():
            return False
        with contextlib.suppress(OSError):  # a full disk: the next call tries again
            write()
            return True
        return False

    def _holds_lock(self) -> bool:
        """True if we hold the lock file. A new lock file that is free is locked."""
        path = self._path / LOCK
        if _identity(path) == _identity(self._lock):
            return True
        try:
            fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError:
            return True  # a full disk: another supervisor cannot create it either
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(fd)
            return False
        self._lock = fd  # the old descriptor stays open; its opener closes it
        return True

    def _touch_all(self) -> None:
        """Updates the access times, so that cleaners spare the files; modification times are kept."""
        for path in (self._path, *self._path.rglob("*")):
            with contextlib.suppress(OSError):
                changed_ns = path.lstat().st_mtime_ns
                os.utime(path, ns=(time.time_ns(), changed_ns), follow_symlinks=False)


def _identity(file: Path | int) -> tuple[int, int] | None:
    try:
        found = os.stat(file)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def claim_path(run_dir: Path) -> socket.socket:
    """Claims this path for one supervisor, even if the directory is removed. Raises ClusterError.

    The claim is an abstract socket, which cannot be deleted and ends with its process.
    """
    name = hashlib.sha256(os.path.realpath(run_dir).encode()).hexdigest()[:32]
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0rtc-{os.getuid()}-{name}")
    except OSError:
        claim.close()
        raise ClusterError(
            f"a cluster that was started in {run_dir} still runs, although its directory was renamed or removed; "
            "it halts and ends within seconds: try again"
        ) from None
    return claim
