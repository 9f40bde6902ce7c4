"""How much room is left between what each verb meets and the thresholds that decide its outcome?

    python -m benchmarks.margins [--starts 5] [--variant "mass 0.9" ...] [--verb PLACE ...] [--processes 1] [--out FILE]
    python -m benchmarks.margins --provoke [NAME ...] [--starts 3]
    python -m benchmarks.margins --closings
    python -m benchmarks.margins --join a.jsonl b.jsonl ...

Each verb under each variant of the physics and the pictures, from several starts: the scenes and pose errors of
`benchmarks.skills`. In physics, in one process, without a broker. Each threshold notes the most extreme value that it
met. `--out` keeps each sentence; what is in it is not repeated. `--provoke` makes the failures that thresholds are for,
and keeps them in the same file; the table has both. `--closings`: hands that close on bars, on nothing, against a wall.

    lowest_rate    share of successes of the verb with the fewest
    runs           sentences that were given
"""

from __future__ import annotations

import argparse
from itertools import product
from pathlib import Path

from benchmarks.copies import in_copies
from benchmarks.margins import table
from benchmarks.margins.closings import all_closings
from benchmarks.margins.provoked import PROVOKED, ProvokedTrial
from benchmarks.margins.runs import SCENES_OF_MARGINS, MarginTrial, joined, prepare
from benchmarks.margins.variants import VARIANTS
from benchmarks.report import RESULTS, finish, question


def made(given: argparse.Namespace) -> None:
    """Make the runs that are not in the file. Trials are prepared once, and continue in copies."""
    trials = prepare(given.verb or list(SCENES_OF_MARGINS))
    numbers = range(given.seed_from, given.seed_from + given.starts)
    there = {run.key for run in joined([given.out])}

    def left(number: int, variant: str, trial: int) -> list[str]:
        verbs = trials[trial][1]
        return [verb for verb in verbs if (SCENES_OF_MARGINS[verb].sentences[-1], variant, number) not in there]

    def perform(piece: tuple[int, str, int]) -> None:
        number, variant, trial = piece
        trials[trial][0].under(variant, left(*piece), number, given.out)

    pieces = product(numbers, given.variant or VARIANTS, range(len(trials)))
    for _ in in_copies(perform, [piece for piece in pieces if left(*piece)], given.processes):
        pass


def provoked(given: argparse.Namespace) -> None:
    for name in given.provoke or PROVOKED:
        verb = PROVOKED[name].verb
        [(trial, _)] = prepare([verb], ProvokedTrial)

        def perform(number: int, trial: MarginTrial = trial, name: str = name, verb: str = verb) -> None:
            trial.under(name, [verb], number, given.out)

        for _ in in_copies(perform, range(given.seed_from, given.seed_from + given.starts), given.processes):
            pass


def main() -> None:
    words = argparse.ArgumentParser(
        prog="python -m benchmarks.margins", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    words.add_argument("--starts", type=int, default=5, help="runs of each verb under each variant")
    words.add_argument("--seed-from", type=int, default=0, help="number of the first start")
    words.add_argument("--variant", nargs="+", choices=VARIANTS, help="these alone")
    words.add_argument("--verb", nargs="+", choices=SCENES_OF_MARGINS, help="these alone")
    words.add_argument("--processes", type=int, default=1)
    words.add_argument(
        "--out", type=Path, default=RESULTS / "margins.jsonl", help="keeps the runs; those in it are not repeated"
    )
    words.add_argument("--join", type=Path, nargs="+", help="report the runs of these files")
    words.add_argument("--provoke", nargs="*", choices=PROVOKED, help="make these failures; without a name: all")
    words.add_argument("--closings", action="store_true", help="close hands alone")
    given = words.parse_args()
    question("margins", "how far from its thresholds does each verb end?")
    if given.closings:
        print("\n".join(map(str, all_closings())))
        return
    if not given.join:
        (made if given.provoke is None else provoked)(given)
    runs = joined(given.join or [given.out])
    done = [run for run in runs if run.variant in VARIANTS]
    metrics, rows = table.metrics_of(done)
    print("\n".join([*table.extremes(done), "", *table.of_thresholds(done, runs)]))
    finish("margins", metrics, rows, data=table.of_thresholds(done, runs))


if __name__ == "__main__":
    main()
