"""Other work on the cores, as in a cluster: `python -m benchmarks.hypercube.neighbour`, until it is ended.

A core that sleeps between two messages is slow to wake up, and a process that is alone finds its data in the caches.
Neither is so in a cluster. So `--measure` runs one neighbour per core, each busy for half of the time.
"""

from __future__ import annotations

import contextlib
import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
PERIOD_S = 0.001  # busy, then asleep, for this long each
TABLES, ENTRIES = 2_000, 50  # some megabytes: more than the caches of one core
NICENESS = 5  # as that of workers


@contextlib.contextmanager
def neighbours(count: int) -> Iterator[None]:
    """Run this many neighbours until the block ends."""
    running = [subprocess.Popen([sys.executable, "-m", __name__], cwd=ROOT) for _ in range(count)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def main() -> None:
    os.nice(NICENESS)
    tables = [{str(key): key for key in range(ENTRIES)} for _ in range(TABLES)]
    parent = os.getppid()
    while os.getppid() == parent:
        until_s = time.perf_counter() + PERIOD_S
        while time.perf_counter() < until_s:
            table = random.choice(tables)
            tables[sum(table.values()) % TABLES] = dict(table)
        time.sleep(PERIOD_S)


if __name__ == "__main__":
    main()
