"""The run directory of a cluster: whether its supervisor lives, and whether its processes listen."""

from __future__ import annotations

import fcntl
import socket as unix
from collections.abc import Iterable
from pathlib import Path

from rtc.protocol.outcomes import NoCluster
from rtc.runtime.settings import ENDPOINTS, LOCK, SETTINGS, Settings, shell_command


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


def is_listening(run_dir: Path, endpoints: Iterable[str]) -> bool:
    """True if a process listens on one of these sockets of a cluster, or its supervisor lives and will restart it."""
    return any(_accepts(run_dir / ENDPOINTS[name]) for name in endpoints) or supervised(run_dir, by_hand=False)


def not_running(run_dir: Path) -> NoCluster:
    """The error for a directory where no process listens: a cluster has never been there, or has ended."""
    was = (run_dir / SETTINGS).exists()
    words = f"the cluster in {run_dir} no longer runs" if was else f"no cluster in {run_dir}"
    return NoCluster(f"{words}; start one with: {shell_command('rtc up -d', run_dir)}")


def running_settings(run_dir: Path) -> Settings:
    """The cluster's settings. Raises NoCluster at once if no process listens in `run_dir`."""
    try:
        settings = Settings.load(run_dir)
    except (FileNotFoundError, NotADirectoryError):
        raise not_running(run_dir) from None
    except PermissionError:
        raise NoCluster(f"the cluster in {run_dir} belongs to another user; choose another --run-dir") from None
    if not is_listening(run_dir, ("front", "estop")):
        raise not_running(run_dir)
    return settings


def _accepts(path: Path) -> bool:
    with unix.socket(unix.AF_UNIX) as probe:
        probe.settimeout(0.2)
        try:
            probe.connect(str(path))
        except OSError:
            return False
        return True
