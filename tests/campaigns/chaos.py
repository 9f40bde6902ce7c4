"""Is each killed process of a running cluster ready again, and how soon?

    python -m tests.campaigns.chaos [--kill worker] [--every 2] [--seconds 60] [--stop] [--seed 0] [--run-dir DIR]

It reads the supervisor's process table and sends no messages, so it works whichever process is dead. Exit status 0 if
every process was started again.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import sys
import time
from collections.abc import Callable, Collection
from contextlib import nullcontext
from pathlib import Path

import msgspec

from rtc.apps.demos.own_cluster import own_cluster
from rtc.protocol.messages import ProcessRow
from rtc.runtime.process import now_s
from rtc.runtime.process_table import processes
from rtc.runtime.settings import Settings

BACK_LIMIT_S = 30.0  # for the last killed process to be ready again
LOOK_S = 0.01

#: value of --kill -> whether it means a process; called with its row and the names of subsystems of arms
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


def main() -> int:
    words = argparse.ArgumentParser(
        prog="python -m tests.campaigns.chaos",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    words.add_argument("--kill", default="any", choices=list(VICTIMS))
    words.add_argument("--every", type=float, default=2.0, help="seconds between two kills")
    words.add_argument("--seconds", type=float, default=60.0)
    words.add_argument("--stop", action="store_true", help="SIGSTOP instead of SIGKILL: it must be detected")
    words.add_argument("--seed", type=int, default=0)
    words.add_argument("--run-dir", type=Path, help="of your cluster; without it, a kinematic one of its own")
    given = words.parse_args()
    with nullcontext(given.run_dir) if given.run_dir else own_cluster(mcm="kinematic") as run_dir:
        processes(run_dir)  # raises NoCluster
        return torment(Chaos(run_dir, random.Random(given.seed), given.stop), given)


def torment(maker: Chaos, given: argparse.Namespace) -> int:
    """The exit status."""
    begun_s = next_s = time.monotonic()
    while time.monotonic() < begun_s + given.seconds + (BACK_LIMIT_S if maker.missing else 0.0):
        if next_s <= time.monotonic() < begun_s + given.seconds:
            next_s += given.every
            strike = maker.strike(given.kill)
            print(f"struck {strike.name} (pid {strike.pid})" if strike else f"there is no {given.kill}", flush=True)
        for strike in maker.returned():
            print(f"    {strike.name} is back after {strike.back_s:.3f} s (pid {strike.new_pid})", flush=True)
        time.sleep(LOOK_S)
    back = sorted(strike.back_s for strike in maker.strikes if strike.back_s is not None)
    figures = f", after {back[len(back) // 2]:.3f} s in the median, {back[-1]:.3f} s at worst" if back else ""
    print(f"{len(back)} of {len(maker.strikes)} are back{figures}; missing: {[one.name for one in maker.missing]}")
    return 1 if maker.missing else 0


if __name__ == "__main__":
    sys.exit(main())
