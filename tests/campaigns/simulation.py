"""Does a cluster lose, repeat or misreport anything when its processes die at the worst moments?

Runs whole clusters on a simulated clock, one seed each (tests/simulation/cluster.py). Delays, repeated requests and
halts occur at random. Processes are killed, hung and stopped at random; the broker also in the middle of a turn. Every
sentence must end once, with an outcome that agrees with the actions of the simulated MCM.

    python -m tests.campaigns.simulation [--seeds N] [--seed FIRST]
"""

from __future__ import annotations

import argparse
import gc
import sys
import time
from collections import Counter

from benchmarks.report import finish, question
from tests.campaigns import RESULTS
from tests.simulation.__main__ import run


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0, help="the first")
    asked = parser.parse_args()
    question("simulation", f"what do {asked.seeds} clusters lose, each with its own faults?", seed=asked.seed)
    gc.freeze()  # imported modules stay alive; this saves a quarter of the time
    gc.set_threshold(50_000, 20, 100)
    faults: Counter[str] = Counter()
    outcomes: Counter[str] = Counter()
    failed, simulated_s, began = [], 0.0, time.perf_counter()
    for n in range(asked.seeds):
        result = run(asked.seed + n)
        faults += result.faults
        outcomes += result.outcomes
        simulated_s += result.simulated_s
        if result.problem:
            failed.append(result.seed)
            print(f"  seed {result.seed}: {result.problem}\n    python -m tests.simulation --seed {result.seed} --log")
        if sys.stderr.isatty() and n % 50 == 0:
            print(f"\r  {n} seeds, {len(failed)} failed", end="", file=sys.stderr, flush=True)
    took_s = time.perf_counter() - began
    finish(
        "simulation",
        {
            "seeds": asked.seeds,
            "failures": len(failed),
            "seconds": round(took_s, 1),
            "commands": outcomes.total(),
            "faults": faults.total(),
            "simulated_s": round(simulated_s),
        },
        [
            ("seeds", f"{asked.seeds}, from {asked.seed}; {len(failed)} failed"),
            ("commands", ", ".join(f"{kind} {count}" for kind, count in outcomes.most_common())),
            ("killed, hung or stopped", ", ".join(f"{name} {count}" for name, count in faults.most_common())),
            ("time", f"{simulated_s:.0f} s simulated in {took_s:.0f} s"),
        ],
        RESULTS,
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
