"""Real-time priority of a thread for a short time. Imports nothing that is slow: `rtc halt` begins with it."""

from __future__ import annotations

import os


class real_time:
    """Run the calling thread with real-time priority `rank` in a `with` block; 0: as it is. Raises OSError if it is not
    permitted."""

    def __init__(self, rank: int) -> None:
        self._rank = rank
        self._policy, self._parameters = os.sched_getscheduler(0), os.sched_getparam(0)

    def __enter__(self) -> None:
        if self._rank:
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(self._rank))

    def __exit__(self, *_: object) -> None:
        if self._rank:
            os.sched_setscheduler(0, self._policy, self._parameters)


def may_be_real_time(rank: int) -> bool:
    """Whether this process is permitted to have real-time priority `rank`."""
    try:
        with real_time(rank):
            return True
    except OSError:
        return False
