"""`python -m tests.simulation --seed N --story`: run one seed, or many, of the simulated cluster."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable

import msgspec

from tests.simulation.cluster import Cluster, Wrong


class Result(msgspec.Struct):
    seed: int
    problem: str
    commands: int
    faults: int
    simulated_s: float


def run(seed: int, story: Callable[[str], None] | None = None) -> Result:
    cluster = Cluster(seed, story)
    problem = ""
    try:
        cluster.run()
    except AssertionError as error:
        problem = str(error) or repr(error)
    return Result(seed, problem, len(cluster.stories), cluster.faults.total(), cluster.clock.now_s - 1000.0)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.simulation", description=__doc__)
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--seeds", type=int, default=1, help="how many, one after the other")
    parser.add_argument("--story", action="store_true", help="tell what happens, event by event")
    asked = parser.parse_args()
    began, failed = time.perf_counter(), 0
    for seed in range(asked.seed, asked.seed + asked.seeds):
        result = run(seed, print if asked.story else None)
        if result.problem:
            failed += 1
            print(f"seed {seed}: {result.problem}\n  python -m tests.simulation --seed {seed} --story")
    print(f"{asked.seeds} seeds, {failed} failed, {time.perf_counter() - began:.1f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
