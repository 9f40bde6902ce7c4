"""The limit for sensors of installed packages, which run in the thread of the cameras, where no signal cuts them off.

The loop of S&P looks at the thread's use of the processor. What exceeds the limit is cut off by an exception in that
thread. What does not end by that, such as a call of a library, ends the process; the supervisor starts it anew.
"""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable

from rtc.plugins import guard
from rtc.plugins.guard import LIMIT_S, TookTooLong

IDLE_S = 3 * LIMIT_S  # without use of the processor: a busy machine may let it wait, too
PROGRESS_S = 0.001  # least processor time that counts as use
GRACE_S = 2.0  # from the exception until the process ends


class SensorWatch:
    """Of this process. `announce`: called with the name of the code before it runs."""

    def __init__(self, announce: Callable[[str], None]) -> None:
        self._announce, self._announced = announce, ""
        self._inside = ""
        self._thread, self._clock = 0, 0
        self._began_s = self._seen_s = 0.0  # processor time of its thread: at the begin; when it was last used
        self._used_at_s = self._cut_at_s = 0.0
        guard.tell(self._calls)

    def _calls(self, name: str) -> None:
        """In the thread of the cameras: code of a package begins, or has ended ("")."""
        self._inside = ""
        if not name:
            return
        if name != self._announced:
            self._announced = name
            self._announce(name)
        self._thread = threading.get_ident()
        self._clock = time.pthread_getcpuclockid(self._thread)
        self._began_s = self._seen_s = time.thread_time()
        self._used_at_s, self._cut_at_s = time.monotonic(), 0.0
        self._inside = name

    def look(self, now_s: float) -> str:
        """Cut off what exceeds its limit. The name of code that has not ended by that, or ''."""
        inside = self._inside
        if not inside:
            return ""
        used_s = time.clock_gettime(self._clock)
        if used_s - self._seen_s >= PROGRESS_S:
            self._seen_s, self._used_at_s = used_s, now_s
        if self._cut_at_s:
            return inside if now_s - self._cut_at_s > GRACE_S else ""
        if used_s - self._began_s > LIMIT_S or now_s - self._used_at_s > IDLE_S:
            self._cut_at_s = now_s
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self._thread), ctypes.py_object(TookTooLong))
        return ""
