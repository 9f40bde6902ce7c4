"""Signs of life of a worker during a job, from a thread of its own.

They carry the processor time that the job has used, so that the broker can tell a job that hangs from one that waits
for a busy processor. A job that holds the interpreter in one call of a library gives none.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

BEAT_S = 0.5


class Pulse:
    """`beat(worked_s)` is called every BEAT_S within `with pulse:`, a part of a job that does not use what `beat` uses.
    `worked_s`: processor time since the first of these calls, because a quick job should not pay for a measurement.

    The two threads never run in such a part at once: its end waits for a beat that is under way. Made by the thread
    that works.
    """

    def __init__(self, beat: Callable[[float], None]) -> None:
        self._beat = beat
        self._clock = time.pthread_getcpuclockid(threading.get_ident())
        self._part = 0  # number of such parts so far
        self._inside = False
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="pulse", daemon=True)
        self._thread.start()

    def __enter__(self) -> None:
        self._part += 1
        self._inside = True

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside = False

    def beat(self) -> None:
        """A beat now, of the thread that works."""
        with self._lock:
            self._beat(0.0)

    def close(self) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        part, began_s = 0, 0.0
        while not self._over.wait(BEAT_S):
            with self._lock:
                if self._inside:
                    now_s = time.clock_gettime(self._clock)
                    if part != self._part:
                        part, began_s = self._part, now_s
                    self._beat(now_s - began_s)
