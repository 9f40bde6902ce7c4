"""`python -m tests.simulation --seed N --log`: run one seed, or many, of the simulated cluster."""

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


def run(seed: int, log_line: Callable[[str], None] | None = None) -> Result:
    """Run one seed from start to end. `log_line` gets each line of the log."""
    cluster = Cluster(seed, log_line)
    problem = ""
    try:
        cluster.run()
    except AssertionError as error:
        problem = str(error) or repr(error)
    outcomes = Counter(log_line.outcome.kind.value for log_line in cluster.records.values() if log_line.outcome)
    return Result(seed, problem, len(cluster.records), cluster.faults, outcomes, cluster.clock.now_s - START_S)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.simulation", description=__doc__)
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--seeds", type=int, default=1, help="how many, one after the other")
    parser.add_argument("--log", action="store_true", help="print each event")
    asked = parser.parse_args()
    began, failed = time.perf_counter(), 0
    for seed in range(asked.seed, asked.seed + asked.seeds):
        result = run(seed, print if asked.log else None)
        if result.problem:
            failed += 1
            print(f"seed {seed}: {result.problem}\n  python -m tests.simulation --seed {seed} --log")
    print(f"{asked.seeds} seeds, {failed} failed, {time.perf_counter() - began:.1f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
