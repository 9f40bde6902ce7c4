"""What a silent broker means: a restarted one is waited for; when all is gone with its supervisor, nobody is.

Knows the cluster's run directory, and who holds the supervisor's lock in it; no sockets, no messages.
"""

from __future__ import annotations

import fcntl
import socket as unix
from collections.abc import Callable, Iterable
from pathlib import Path

from rtc.outcomes import NoCluster
from rtc.settings import ENDPOINTS, LOCK

TOLD_AFTER = 2  # questions without an answer, two seconds each

Tell = Callable[[str], None]


def supervised(run_dir: Path, by_hand: bool = True) -> bool:
    """False when no supervisor lives here, so that nothing of its cluster does, and nothing will come back. Where there
    never was one the cluster was started `by_hand`."""
    try:
        with open(run_dir / LOCK) as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)  # let go of when the file is closed
            return False
    except BlockingIOError:
        return True
    except FileNotFoundError:
        return by_hand and run_dir.exists()


def somebody_listens(run_dir: Path, doors: Iterable[str]) -> bool:
    """True when a process holds one of these sockets of a cluster open, or will again: its supervisor lives."""
    return any(_listens(run_dir / ENDPOINTS[door]) for door in doors) or supervised(run_dir, by_hand=False)


def _listens(path: Path) -> bool:
    with unix.socket(unix.AF_UNIX) as probe:
        probe.settimeout(0.2)
        try:
            probe.connect(str(path))
        except OSError:
            return False
        return True


class Silence:
    """Of one broker. `tell` hears in words when it begins and ends; `run_dir` None: there is none to look into."""

    def __init__(self, run_dir: Path | None, tell: Tell | None) -> None:
        self._run_dir = run_dir
        self._tell = tell
        self._told = False

    def judge(self, unanswered: int, replaced: bool = False) -> None:
        """`unanswered`: how often we have asked in vain; `replaced`: another cluster has answered.

        Raises NoCluster when nobody is left who could."""
        if replaced:
            raise NoCluster(
                f"the cluster {f'in {self._run_dir} ' if self._run_dir else ''}is gone, and another one is in its "
                "place; commands that had not ended will not end. "
                "Connect again, and give them again if they are meant for this cluster"
            )
        if unanswered and self._run_dir is not None and not supervised(self._run_dir):
            raise NoCluster(
                f"the cluster in {self._run_dir} is gone: its supervisor has ended, and everything with it; "
                "commands that had not ended will not end. Start a new cluster with: rtc up -d"
            )
        if unanswered >= TOLD_AFTER and not self._told:
            self._say(
                "the broker does not answer; waiting for it to come back (what moves goes on; Ctrl-C to stop waiting)"
            )
        elif not unanswered and self._told:
            self._say("the broker answers again")
        self._told = unanswered >= TOLD_AFTER or (self._told and unanswered > 0)

    def restarting(self) -> None:
        """It was not there when we came."""
        self._say("the broker does not answer yet; waiting for it, its supervisor is there")
        self._told = True

    def _say(self, words: str) -> None:
        if self._tell is not None:
            self._tell(words)
