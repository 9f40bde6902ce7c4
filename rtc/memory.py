"""When a process holds far more memory than it should: notice it, and let go of what others have filled.

ZeroMQ bounds the length of a frame and the number of messages, but not the number of frames in a message that never
ends; so one who speaks its protocol by hand can have it keep gigabytes. Where that happens cannot be seen. But whoever
talks to a door of ours repeats what was not answered, so a door may be shut and opened anew: all that strangers have
put there is gone, and friends come back within milliseconds.
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

from rtc.process import Every

LIMIT_MB = 512.0  # resident; every process of ours does with a fraction of it
LOOK_S = 0.1
SETTLE_S = 0.5  # until what was let go of can be measured
IN_VAIN = 1.5  # when it did not help, the limit becomes so many times what was found

_MB_PER_PAGE = os.sysconf("SC_PAGE_SIZE") / 2**20
_libc = ctypes.CDLL(None)


def resident_mb(pid: int | str = "self") -> float:
    """Resident memory of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _MB_PER_PAGE


class Guard:
    """`alarm(now)` says which doors should be opened anew: 0 none, 1 those of strangers, 2 the others, because the
    first did not help. When that does not help either, nobody else is the cause, and the limit is raised."""

    def __init__(self, limit_mb: float = LIMIT_MB) -> None:
        self.limit_mb = limit_mb
        self._look = Every(LOOK_S)
        self._stage = 0  # what was told last
        self._settled_s = 0.0  # when the effect of that can be judged

    def alarm(self, now_s: float) -> int:
        if now_s < self._settled_s or not self._look.due(now_s):
            return 0
        if self._stage:
            _libc.malloc_trim(0)
        found_mb = resident_mb()
        if found_mb <= self.limit_mb:
            self._stage = 0
        elif self._stage == 2:
            self.limit_mb, self._stage = found_mb * IN_VAIN, 0
        else:
            self._stage += 1
            self._settled_s = now_s + SETTLE_S
        return self._stage
