"""What the peers share: how they are asked, how their commands are counted, how they answer."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence

LIMIT_S = 120.0  # for a peer to start, warm up, be measured and end
SIZES = (19, 55, 146, 389, 46)  # bytes of a sentence and of the four products


class Missing(Exception):
    """The peer is not installed here."""


def work(size: int, payload: bytes) -> bytes:
    """A trivial job: so many bytes in, so many out."""
    assert payload is not None
    return bytes(size)


class Meter:
    """`ended()` at every end of a command; `rate` is what the benchmark wants to know."""

    def __init__(self, warm_up_s: float, for_s: float) -> None:
        now = time.monotonic()
        self._from_s, self._until_s = now + warm_up_s, now + warm_up_s + for_s
        self._first_s = self._last_s = 0.0
        self._count = 0

    def ended(self) -> bool:
        """Count one; False when it is time to stop."""
        now = time.monotonic()
        if now >= self._from_s:
            self._first_s = self._first_s or now
            self._last_s = now
            self._count += 1
        return now < self._until_s

    @property
    def rate(self) -> float:
        """Commands per second, between the first and the last that counted."""
        return (self._count - 1) / (self._last_s - self._first_s)


def ask(name: str, sizes: Sequence[int], warm_up_s: float, for_s: float) -> float | str:
    """Commands per second of one peer, in processes of its own; or why there is none."""
    command = [sys.executable, "-W", "ignore", "-m", f"benchmarks.peers.{name}"]
    command += ["--warm-up-s", str(warm_up_s), "--for-s", str(for_s), "--sizes", *map(str, sizes)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        return f"no answer within {LIMIT_S:g} s"
    try:
        answer = json.loads(done.stdout.splitlines()[-1])
    except (IndexError, ValueError):
        return f"failed: {(done.stderr.strip().splitlines() or ['(it said nothing)'])[-1]}"
    return answer.get("rate") or answer["missing"]


def main(measure: Callable[[Sequence[int], Callable[[], Meter]], None]) -> None:
    """`measure(sizes, start)` starts what it needs, then the meter, and has commands done until that says stop; `sizes`
    are those of the sentence and of each product. The last line of output is the answer."""
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
    os._exit(0)  # their own ways of ending take long, and are noisy, when commands are still under way
