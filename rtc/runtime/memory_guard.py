"""Memory guard: detects that a process holds far too much memory, and names the sockets to reopen.

ZeroMQ limits the length of a frame and the number of messages, but not the number of frames in one message. A peer
that speaks the protocol by hand can therefore make a process keep gigabytes, and the socket at fault is not visible.
Peers repeat requests that were not answered. So a socket may be closed and opened again: the memory is freed, and
well-behaved peers reconnect within milliseconds.

A process that runs code of packages has a limit of the kernel as well (`limit_data`): there a MemoryError ends the code
that takes more, and not the machine.
"""

from __future__ import annotations

import ctypes
import os
import resource
from enum import IntEnum
from pathlib import Path

from rtc.runtime.process import Every

LIMIT_MB = 512.0  # resident memory; each process needs a fraction of it
LOOK_S = 0.1  # period of the measurement
SETTLE_S = 0.5  # from reopening sockets until the memory can be measured again
RAISE_FACTOR = 1.5  # if reopening did not help, the new limit is this factor times the measured memory

DATA_BYTES = 2 << 30  # of one process that runs code of packages: nine times what the largest of them has

_MB_PER_PAGE = os.sysconf("SC_PAGE_SIZE") / 2**20
_libc = ctypes.CDLL(None)


def resident_mb(pid: int | str = "self") -> float:
    """Resident memory of a process (MB)."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _MB_PER_PAGE


def limit_data() -> None:
    """Let this process, and what it forks, have at most DATA_BYTES of private memory each: beyond, MemoryError."""
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    limit = DATA_BYTES if most == resource.RLIM_INFINITY else min(DATA_BYTES, most)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, most))


class Action(IntEnum):
    """What the owner of the guard must do now."""

    NONE = 0
    RESET_CLIENT_SOCKETS = 1  # those of outside peers
    RESET_INTERNAL_SOCKETS = 2  # the others, because the first reset did not help


class MemoryGuard:
    """Compares resident memory with `limit_mb`. If neither reset helps, sockets are not the cause: the limit rises."""

    def __init__(self, limit_mb: float = LIMIT_MB) -> None:
        self.limit_mb = limit_mb
        self._look = Every(LOOK_S)
        self._last = Action.NONE
        self._settled_s = 0.0  # when the effect of the last action can be measured

    def alarm(self, now_s: float) -> Action:
        """The action that is due at `now_s`; call it in every loop iteration."""
        if now_s < self._settled_s or not self._look.due(now_s):
            return Action.NONE
        if self._last:
            _libc.malloc_trim(0)
        found_mb = resident_mb()
        if found_mb <= self.limit_mb:
            self._last = Action.NONE
        elif self._last is Action.RESET_INTERNAL_SOCKETS:
            self.limit_mb, self._last = found_mb * RAISE_FACTOR, Action.NONE
        else:
            self._last = Action(self._last + 1)
            self._settled_s = now_s + SETTLE_S
        return self._last
