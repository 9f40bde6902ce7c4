"""The run directory as the supervisor looks after it: what somebody deletes is written again, and when the directory or
its lock is not ours any more, the cluster ends.

Cleaners of temporary files delete what nobody has touched for days, and a logout removes the user's runtime directory.
What is needed for a halt, for `rtc down` and for the next client must lie there as long as the cluster runs. The doors
themselves are looked after by the processes that bind them (`rtc.process`).
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

from rtc.outcomes import ClusterError
from rtc.process import Every
from rtc.settings import LOCK

TOUCH_S = 3600.0  # cleaners spare what is younger than a day or more


class Directory:
    """`lock`: a file descriptor of the locked LOCK in it; `files`: how each file is written again, by its name."""

    def __init__(self, run_dir: Path, lock: int, files: Mapping[str, Callable[[], object]]) -> None:
        self._path, self._lock, self._files = run_dir, lock, files
        self._is = _identity(run_dir)
        self._touch = Every(TOUCH_S)

    def look(self, now_s: float) -> tuple[list[str], str]:
        """(what was written again, why the cluster must end). To be called every second."""
        if _identity(self._path) != self._is:
            return [], f"{self._path} was renamed or removed"
        if not self._holds_lock():
            return [], f"another supervisor holds {self._path / LOCK}"
        again = [name for name, write in self._files.items() if self._write_again(name, write)]
        if self._touch.due(now_s):
            self._touch_all()
        return again, ""

    def ours(self) -> bool:
        """Whether it is the directory, with the lock, in which we began."""
        return _identity(self._path) == self._is and self._holds_lock()

    def _write_again(self, name: str, write: Callable[[], object]) -> bool:
        if (self._path / name).exists():
            return False
        with contextlib.suppress(OSError):  # a full disk: the next look tries again
            write()
            return True
        return False

    def _holds_lock(self) -> bool:
        """Whether the lock file is the one we hold; a new one, if nobody holds it, becomes ours."""
        path = self._path / LOCK
        if _identity(path) == _identity(self._lock):
            return True
        try:
            fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError:
            return True  # no room for one: nobody else can make one either
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(fd)
            return False
        self._lock = fd  # the one before stays open: it is its opener's
        return True

    def _touch_all(self) -> None:
        """As if it had been read: cleaners spare that, and the time of the last change stays true."""
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
    """Be the only supervisor for this path, whatever becomes of the directory itself: an abstract socket, which nobody
    can delete and which ends with its process. Raises ClusterError."""
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
