"""Short real commands, one after the other on each arm, from clients that do not know of injected faults.

Each arm moves to and fro between two postures, `far_deg` apart. The outcome of each command is kept. It is compared
with the journal and the MCM's log by `benchmarks.load.verdict`.
"""

from __future__ import annotations

import itertools
import math
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from rtc.client.client import Client
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Outcome, RtcError

ARMS = ("RIGHT-ARM", "LEFT-ARM")
STOWED_DEG = (0, 110, -160, 0, 50, 0)
OUTWARDS = {"RIGHT-ARM": -1, "LEFT-ARM": 1}  # direction of the first joint away from the other arm
NONSENSE = "FLY TO THE MOON"  # refused by the parser; keeps the parser busy
NONSENSE_S = 0.01  # pause between two of these
LIMIT_S = 60.0  # a command without an outcome for this long is lost


@dataclass(frozen=True)
class Errand:
    """One sentence and its outcome."""

    arm: str  # empty: nonsense
    text: str
    goal_rad: tuple[float, ...]
    sent_at_s: float
    ended_at_s: float
    command: str
    outcome: Outcome | None  # None: not received within the limit


class Errands:
    """A context manager: the commands run until the block ends, or until `how_many` are done."""

    def __init__(
        self, run_dir: Path, *, far_deg: float = 5, nonsense: bool = True, how_many: int | None = None
    ) -> None:
        self._run_dir, self._far_deg = run_dir, far_deg
        self._over = threading.Event()
        self._left = None if how_many is None else iter(range(how_many))
        self._lock = threading.Lock()
        self.done: list[Errand] = []
        self._threads = [threading.Thread(target=self._go_to_and_fro, args=(arm,)) for arm in ARMS]
        if nonsense:
            self._threads.append(threading.Thread(target=self._talk_nonsense))

    def __enter__(self) -> Errands:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self.join()

    @property
    def running(self) -> bool:
        return any(thread.is_alive() for thread in self._threads)

    def join(self) -> None:
        for thread in self._threads:
            thread.join()

    def _go_to_and_fro(self, arm: str) -> None:
        with Client(self._run_dir) as rtc:
            away = (OUTWARDS[arm] * self._far_deg, *STOWED_DEG[1:])
            for posture in itertools.cycle((away, STOWED_DEG)):
                if not self._another():
                    return
                text = f"MOVE {arm} TO JOINTS {' '.join(map(str, posture))} DEG JOINT-MOTION"
                self._run(rtc, arm, text, tuple(map(math.radians, posture)))

    def _talk_nonsense(self) -> None:
        with Client(self._run_dir) as rtc:
            while not self._over.is_set():
                self._run(rtc, "", NONSENSE, ())
                self._over.wait(NONSENSE_S)

    def _another(self) -> bool:
        with self._lock:
            return not self._over.is_set() and (self._left is None or next(self._left, None) is not None)

    def _run(self, rtc: Client, arm: str, text: str, goal_rad: tuple[float, ...]) -> None:
        sent_at_s = time.monotonic()
        ended: m.CommandEnded | None = None
        while ended is None and time.monotonic() - sent_at_s < LIMIT_S:
            try:
                ended = rtc.run(text, timeout_s=LIMIT_S)
            except RtcError:
                break
        errand = Errand(
            arm=arm,
            text=text,
            goal_rad=goal_rad,
            sent_at_s=sent_at_s,
            ended_at_s=time.monotonic(),
            command=ended.command if ended else "",
            outcome=ended.outcome if ended else None,
        )
        with self._lock:
            self.done.append(errand)
