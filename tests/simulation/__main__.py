"""`python -m tests.simulation --seed N --story`: run one seed, or many, of the simulated cluster."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable

import msgspec

from tests.simulation.cluster import Cluster
from tests.simulation.network import START_S


class Result(msgspec.Struct):
    """What came of one seed."""

    seed: int
    problem: str  # empty: all that must hold held
    commands: int
    faults: Counter[str]
    outcomes: Counter[str]
    simulated_s: float


def run(seed: int, story: Callable[[str], None] | None = None) -> Result:
    """One seed, from start to end. The story is told line by line, if somebody wants to hear it."""
    cluster = Cluster(seed, story)
    problem = ""
    try:
        cluster.run()
    except AssertionError as error:
        problem = str(error) or repr(error)
    outcomes = Counter(story.outcome.kind.value for story in cluster.stories.values() if story.outcome)
    return Result(seed, problem, len(cluster.stories), cluster.faults, outcomes, cluster.clock.now_s - START_S)


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
