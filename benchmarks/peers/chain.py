"""Common parts of the peers: their start, the count of their commands, their answer."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence

LIMIT_S = 120.0  # limit for start, warm-up, measurement and end of a peer
SIZES = (19, 55, 146, 389, 46)  # bytes of a sentence and of the four products


class Missing(Exception):
    """The peer is not installed on this machine."""


def work(size: int, payload: bytes) -> bytes:
    """A trivial job: a number of bytes in, a number of bytes out."""
    assert payload is not None
    return bytes(size)


class Meter:
    """Call `ended()` at each end of a command; `rate` is the result."""

    def __init__(self, warm_up_s: float, for_s: float) -> None:
        now = time.monotonic()
        self._from_s, self._until_s = now + warm_up_s, now + warm_up_s + for_s
        self._first_s = self._last_s = 0.0
        self._count = 0

    def ended(self) -> bool:
        """Count one command; False when the measurement is complete."""
        now = time.monotonic()
        if now >= self._from_s:
            self._first_s = self._first_s or now
            self._last_s = now
            self._count += 1
        return now < self._until_s

    @property
    def rate(self) -> float:
        """Commands per second between the first and the last counted one."""
        return (self._count - 1) / (self._last_s - self._first_s)


def ask(name: str, sizes: Sequence[int], warm_up_s: float, for_s: float) -> float | str:
    """Commands per second of one peer, run in its own processes; or the reason why there is no figure."""
    command = [sys.executable, "-W", "ignore", "-m", f"benchmarks.peers.{name}"]
    command += ["--warm-up-s", str(warm_up_s), "--for-s", str(for_s), "--sizes", *map(str, sizes)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        return f"no answer within {LIMIT_S:g} s"
    try:
        answer = json.loads(done.stdout.splitlines()[-1])
    except (IndexError, ValueError):
        return f"failed: {(done.stderr.strip().splitlines() or ['(no output)'])[-1]}"
    return answer.get("rate") or answer["missing"]


def main(measure: Callable[[Sequence[int], Callable[[], Meter]], None]) -> None:
    """Run a peer and print its rate as the last line of output.

    `measure(sizes, start)` starts its processes, then the meter, and runs commands until the meter stops it. `sizes`
    are the sizes of the sentence and of each product (bytes).
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--warm-up-s", type=float, default=1.0)
    parser.add_argument("--for-s", type=float, default=3.0)
    given = parser.parse_args()
    made: list[Meter] = []

    def start() -> Meter:
        made.append(Meter(given.warm_up_s, given.for_s))
        return made[0]

    try:
        measure(given.sizes, start)
        print(json.dumps({"rate": made[0].rate}), flush=True)
    except (Missing, ImportError) as error:
        print(json.dumps({"missing": str(error)}), flush=True)
    os._exit(0)  # an orderly end of a framework with commands in progress takes long and prints errors
