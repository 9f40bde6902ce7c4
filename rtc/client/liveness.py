"""Liveness of the broker as a client sees it: wait for a restart while the supervisor lives, else raise NoCluster.

It does not know messages, and reads no file: whether the supervisor lives is passed in.
"""

from __future__ import annotations

from collections.abc import Callable

from rtc.protocol.outcomes import NoCluster

REPORT_AFTER = 2  # unanswered probes, two seconds each, before the user gets a message

CONTINUE = "motions continue"

Report = Callable[[str], None]
Supervised = Callable[[bool], bool]


class BrokerLiveness:
    """State of one broker: answering or not. `report` gets a message when that changes.

    `where`: the run directory, for people. `supervised`: whether the supervisor lives; its argument is the answer for a
    cluster that was started by hand. None for a cluster on another machine, whose supervisor lock cannot be read.
    `halts`: it halts the commands of a client that it has lost.
    """

    def __init__(
        self, where: str = "", supervised: Supervised | None = None, report: Report | None = None, halts: bool = False
    ) -> None:
        self._where, self._supervised, self._report = where, supervised, report
        self._meanwhile = "it halts your commands after some seconds without a sign of you" if halts else CONTINUE
        self._reported = False  # that the broker does not answer

    def check(self, unanswered: int, replaced: bool = False, lost: bool = False) -> None:
        """Judge the connection. Raises NoCluster if no process is left that could answer.

        `unanswered` is the number of probes without an answer; `replaced`: another cluster has answered;
        `lost`: there is no connection any more.
        """
        if replaced:
            raise NoCluster(
                f"the cluster {f'in {self._where} ' if self._supervised else ''}is gone, and another one is in its "
                "place; commands that had not ended will not end. "
                "Connect again, and submit them again if they are meant for this cluster"
            )
        if unanswered and self._supervised is not None and not self._supervised(True):
            raise NoCluster(
                f"the cluster in {self._where} is gone: its supervisor has ended, and all its processes with it; "
                "commands that had not ended will not end. Start a new cluster with: rtc up -d"
            )
        silent = lost or unanswered >= REPORT_AFTER
        if silent and not self._reported:
            what = "the link to the cluster is lost" if lost else "the broker does not answer"
            self._send(f"{what}; waiting for it ({self._meanwhile}; Ctrl-C stops waiting)")
        elif not silent and not unanswered and self._reported:
            self._send("the broker answers again")
        self._reported = silent or (self._reported and unanswered > 0)

    def is_restarting(self) -> bool:
        """Whether a broker that was absent at the first connection will come: its supervisor is there. Reports it."""
        if self._supervised is None or not self._supervised(False):
            return False
        if not self._reported:
            self._send("the broker does not answer yet; waiting for it, because its supervisor is running")
        self._reported = True
        return True

    def no_answer(self) -> NoCluster:
        """The error of a broker that has not sent its first Welcome."""
        return NoCluster(
            f"no broker answers in {self._where}; look at `rtc status`, or start a cluster with: rtc up -d"
        )

    def _send(self, words: str) -> None:
        if self._report is not None:
            self._report(words)
