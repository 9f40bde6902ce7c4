"""The run directory of a cluster: whether its supervisor lives."""

from __future__ import annotations

import fcntl
from pathlib import Path

from rtc.runtime.settings import LOCK


def supervised(run_dir: Path, by_hand: bool = True) -> bool:
    """True while a process holds the supervisor lock in `run_dir`.

    Without a lock file the cluster may have been started by hand: then `by_hand` is the answer.
    """
    try:
        with open(run_dir / LOCK) as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)  # closing the file releases it
            return False
    except BlockingIOError:
        return True
    except FileNotFoundError:
        return by_hand and run_dir.exists()
