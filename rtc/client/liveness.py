"""Liveness of the broker as a client sees it: wait for a restart while the supervisor lives, else raise NoCluster.

It knows the cluster's run directory and the supervisor's lock in it. It does not know messages.
"""

from __future__ import annotations

import socket as unix
from collections.abc import Callable, Iterable
from pathlib import Path

from rtc.protocol.outcomes import NoCluster
from rtc.runtime.run_dir import supervised
from rtc.runtime.settings import ENDPOINTS, SETTINGS, shell_command

REPORT_AFTER = 2  # unanswered probes, two seconds each, before the user gets a message

CONTINUE = "motions continue"

Report = Callable[[str], None]


def is_listening(run_dir: Path, endpoints: Iterable[str]) -> bool:
    """True if a process listens on one of these sockets of a cluster, or its supervisor lives and will restart it."""
    return any(_accepts(run_dir / ENDPOINTS[name]) for name in endpoints) or supervised(run_dir, by_hand=False)


def not_running(run_dir: Path) -> NoCluster:
    """The error for a directory where no process listens: a cluster has never been there, or has ended."""
    was = (run_dir / SETTINGS).exists()
    words = f"the cluster in {run_dir} no longer runs" if was else f"no cluster in {run_dir}"
    return NoCluster(f"{words}; start one with: {shell_command('rtc up -d', run_dir)}")


def _accepts(path: Path) -> bool:
    with unix.socket(unix.AF_UNIX) as probe:
        probe.settimeout(0.2)
        try:
            probe.connect(str(path))
        except OSError:
            return False
        return True


class BrokerLiveness:
    """State of one broker: answering or not. `report` gets a message when that changes.

    `run_dir` is None for a cluster on another machine, whose supervisor lock cannot be read. `halts`: it halts the
    commands of a client that it has lost.
    """

    def __init__(self, run_dir: Path | None, report: Report | None, halts: bool = False) -> None:
        self._run_dir = run_dir
        self._meanwhile = "it halts your commands after some seconds without a sign of you" if halts else CONTINUE
        self._report = report
        self._reported = False  # that the broker does not answer

    def check(self, unanswered: int, replaced: bool = False, lost: bool = False) -> None:
        """Judge the connection. Raises NoCluster if no process is left that could answer.

        `unanswered` is the number of probes without an answer; `replaced`: another cluster has answered;
        `lost`: there is no connection any more.
        """
        if replaced:
            raise NoCluster(
                f"the cluster {f'in {self._run_dir} ' if self._run_dir else ''}is gone, and another one is in its "
                "place; commands that had not ended will not end. "
                "Connect again, and submit them again if they are meant for this cluster"
            )
        if unanswered and self._run_dir is not None and not supervised(self._run_dir):
            raise NoCluster(
                f"the cluster in {self._run_dir} is gone: its supervisor has ended, and all its processes with it; "
                "commands that had not ended will not end. Start a new cluster with: rtc up -d"
            )
        silent = lost or unanswered >= REPORT_AFTER
        if silent and not self._reported:
            what = "the link to the cluster is lost" if lost else "the broker does not answer"
            self._send(f"{what}; waiting for it ({self._meanwhile}; Ctrl-C stops waiting)")
        elif not silent and not unanswered and self._reported:
            self._send("the broker answers again")
        self._reported = silent or (self._reported and unanswered > 0)

    def restarting(self) -> None:
        """Report that the broker was absent at the first connection and that its supervisor is there."""
        self._send("the broker does not answer yet; waiting for it, because its supervisor is running")
        self._reported = True

    def _send(self, words: str) -> None:
        if self._report is not None:
            self._report(words)
