"""Other work on the cores, as in a cluster: `python -m benchmarks.hypercube.neighbour`, until it is ended.

A core that sleeps between two messages is slow to wake up, and a process that is alone finds its data in the caches.
Neither is so in a cluster. So `--measure` runs one neighbour per core. Each is busy for half of the time, or always. A
saturated broker works while the workers keep all other cores busy. These often share caches and units with its own.
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
RESTLESS = "--restless"


@contextlib.contextmanager
def neighbours(*, resting: bool = True) -> Iterator[None]:
    """Run one neighbour per core until the block ends. `resting`: each sleeps for half of the time."""
    command = [sys.executable, "-m", __name__, *(() if resting else (RESTLESS,))]
    running = [subprocess.Popen(command, cwd=ROOT) for _ in os.sched_getaffinity(0)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def main() -> None:
    os.nice(NICENESS)
    tables = [{str(key): key for key in range(ENTRIES)} for _ in range(TABLES)]
    parent, resting = os.getppid(), RESTLESS not in sys.argv
    while os.getppid() == parent:
        until_s = time.perf_counter() + PERIOD_S
        while time.perf_counter() < until_s:
            table = random.choice(tables)
            tables[sum(table.values()) % TABLES] = dict(table)
        if resting:
            time.sleep(PERIOD_S)


if __name__ == "__main__":
    main()
