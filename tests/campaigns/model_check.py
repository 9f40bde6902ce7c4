"""Is there any order of events in which two commands break a rule of the Decision Unit, or never end?

Explores all interleavings of small scenarios (tests/simulation/scenarios.py), with every way to place N faults. Faults
are halts, dead workers, late and repeated answers, and timeouts. A subsystem dies, or is silent, and returns. The
broker is killed at any point of a batch. On a violation it prints the shortest path to it and exits with status 1.

    python -m tests.campaigns.model_check [--depth N] [--seconds S] [--faults N] [--scenario WORDS]
"""

from __future__ import annotations

import argparse
import sys

import msgspec

from benchmarks.report import finish, question
from tests.campaigns import RESULTS
from tests.simulation.explore import Found, describe, explore
from tests.simulation.scenarios import SCENARIOS


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--depth", type=int, default=1000, help="moves from the start (default: all)")
    parser.add_argument("--seconds", type=float, default=600.0, help="for all scenarios together (default: 600)")
    parser.add_argument("--faults", type=int, default=2, help="of all kinds, in one run (default: 2)")
    parser.add_argument("--scenario", default="", help="only those whose name holds these words")
    asked = parser.parse_args()
    chosen = [s for s in SCENARIOS if asked.scenario in s.name]
    question("model_check", f"can {asked.faults} faults, anywhere, break a rule or keep a command from its end?")
    left_s, found = asked.seconds, []
    for n, scenario in enumerate(chosen):
        scenario = msgspec.structs.replace(scenario, faults=asked.faults)
        seen = explore(scenario, depth=asked.depth, seconds=left_s / (len(chosen) - n), progress=_progress)
        left_s -= seen.seconds
        found.append(seen)
        print(f"\r  {_row(seen)[0]:<30} {_row(seen)[1]:<90}", flush=True)
        if seen.violation:
            print(describe(seen, scenario))
    finish(
        "model_check",
        {
            "states": sum(seen.states for seen in found),
            "transitions": sum(seen.transitions for seen in found),
            "depth": max(seen.depth for seen in found),
            "faults": asked.faults,
            "complete": sum(seen.complete for seen in found),
            "scenarios": len(found),
            "violations": sum(bool(seen.violation) for seen in found),
            "seconds": round(sum(seen.seconds for seen in found), 1),
        },
        [_row(seen) for seen in found],
        RESULTS,
    )
    return 1 if any(seen.violation for seen in found) else 0


def _progress(found: Found) -> None:
    if sys.stderr.isatty():
        print(f"\r  {found.scenario}: depth {found.depth}, {found.states} states", end="", file=sys.stderr, flush=True)


def _row(found: Found) -> tuple[str, str]:
    end = "VIOLATION" if found.violation else "all" if found.complete else "cut short"
    return found.scenario, (
        f"{found.states} states, {found.transitions} transitions, depth {found.depth}, {found.seconds:.1f} s: {end}"
    )


if __name__ == "__main__":
    sys.exit(main())
