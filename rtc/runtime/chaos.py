"""Fault injection: kill or stop processes of a running cluster, and measure when each is ready again.

It reads the supervisor's process table and sends no messages, so it works whichever process is dead.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
from collections.abc import Callable, Collection
from pathlib import Path

import msgspec

from rtc.protocol.messages import ProcessRow
from rtc.runtime.process import now_s
from rtc.runtime.process_table import processes
from rtc.runtime.settings import Settings

#: value of `rtc chaos --kill` -> whether it means a process; called with its row and the names of subsystems of arms
VICTIMS: dict[str, Callable[[ProcessRow, Collection[str]], bool]] = {
    "worker": lambda row, moving: row.node is not None,
    "broker": lambda row, moving: row.name == "broker",
    "world": lambda row, moving: row.name == "world",
    "mcm": lambda row, moving: row.name in moving,
    "template": lambda row, moving: row.name.endswith("template"),
    "any": lambda row, moving: True,
}


class Strike(msgspec.Struct):
    """One killed or stopped process."""

    name: str
    pid: int
    at_s: float
    back_s: float | None = None  # from the strike until its successor was ready
    new_pid: int = 0


class Chaos:
    """Call `strike` now and then, and `returned` in between."""

    def __init__(self, run_dir: Path, rng: random.Random, stop: bool = False) -> None:
        self._run_dir, self._rng = run_dir, rng
        self._signal = signal.SIGSTOP if stop else signal.SIGKILL
        self.strikes: list[Strike] = []

    @property
    def missing(self) -> list[Strike]:
        """Strikes whose process is not ready again."""
        return [strike for strike in self.strikes if strike.back_s is None]

    def strike(self, kind: str, name: str = "") -> Strike | None:
        """Kill one ready process of this kind (or the one called `name`); None if there is none."""
        struck = {strike.pid for strike in self.missing}
        moving = Settings.load(self._run_dir).with_estop
        able = [
            row
            for row in processes(self._run_dir).values()
            if VICTIMS[kind](row, moving) and name in ("", row.name) and row.state == "ready" and row.pid not in struck
        ]
        if not able:
            return None
        victim = self._rng.choice(able)
        at_s = now_s()
        if not self._hit(victim):
            return None
        self.strikes.append(Strike(name=victim.name, pid=victim.pid, at_s=at_s))
        return self.strikes[-1]

    def _hit(self, row: ProcessRow) -> bool:
        """False if it has ended meanwhile: its pid may belong to another process."""
        with contextlib.suppress(ProcessLookupError):
            fd = os.pidfd_open(row.pid)
            try:
                now = processes(self._run_dir).get(row.name)
                if now is not None and now.pid == row.pid:
                    signal.pidfd_send_signal(fd, self._signal)
                    return True
            finally:
                os.close(fd)
        return False

    def returned(self) -> list[Strike]:
        """Strikes whose process is ready again, each reported once."""
        rows = processes(self._run_dir)
        found = []
        for strike in self.missing:
            row = rows.get(strike.name)
            if row is not None and row.pid not in (0, strike.pid) and row.state == "ready":
                strike.back_s, strike.new_pid = row.since_s - strike.at_s, row.pid
                found.append(strike)
        return found
