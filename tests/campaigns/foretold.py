"""Do the facts that a TEST predicts contain what the sentence then leaves, as often as their spreads say?

Modules are displaced by errors whose two sigma are what the cell states of them, on each axis. Each sentence is first
rehearsed, then performed, with exact arms and cameras. An axis of a pose counts as inside if the fact that the
sentence leaves is within the predicted spread of the predicted fact; for such errors 95 % of all axes are.

    python -m tests.campaigns.foretold [--runs 40]
"""

from __future__ import annotations

import argparse

import numpy as np

from benchmarks.grasp import wilson
from benchmarks.report import finish, question
from rtc.protocol.outcomes import OutcomeKind
from rtc.spatial import geometry
from rtc.world.model import World, initial_facts
from sim_mcm.arms.kinematic_arm import KinematicCell
from tests.campaigns import RESULTS
from tests.workers.conftest import CELL, MODEL
from tests.workers.eyes import Ideal
from tests.workers.one_process import OneProcess

SEED = 11
MODULES = ("MACS-NEW", "MACS-OLD")
SENTENCES = ("LOCATE MACS-NEW", "LOCATE MACS-OLD", "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM")
GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"
LOOSE_M, LOOSE_RAD = 1e-4, 1e-3  # of arithmetic


def inside(rng: np.random.Generator) -> list[tuple[str, bool]]:
    """(sentence and key, whether an axis is inside) of one run."""
    sim = KinematicCell(CELL)
    for name in MODULES:
        within = CELL.object(name).known_within
        if within is not None:
            sim.displace(name, (0.5 * np.array(within.spread) * rng.normal(size=6)).tolist())
    cluster = OneProcess(sim, MODEL, World().overlay(initial_facts(CELL)), Ideal(CELL))
    found: list[tuple[str, bool]] = []
    for sentence in (*SENTENCES[:2], GRASP, SENTENCES[2]):
        tested = cluster.give(f"TEST {sentence}")
        cluster.run(200.0)
        done = cluster.give(sentence)
        cluster.run(400.0)
        rehearsal = cluster.outcomes[tested].rehearsal
        if rehearsal is None or cluster.outcomes[done].kind is not OutcomeKind.SUCCEEDED:
            break
        for fact in rehearsal.changes:
            now = cluster.world.facts.get(fact.key)
            if fact.spread is None or now is None or not now.value or not fact.key.endswith((".frame", ".grasp")):
                continue
            off = geometry.relative(fact.value, now.value)
            errors = [*off[:3], *geometry.to_rpy(off)]
            loose = [LOOSE_M] * 3 + [LOOSE_RAD] * 3
            found += [
                (f"{sentence}: {fact.key}", abs(e) <= s + t) for e, s, t in zip(errors, fact.spread, loose, strict=True)
            ]
    return found


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--runs", type=int, default=40)
    given = words.parse_args()
    question("foretold", "do predicted facts contain what the sentence then leaves?", seed=SEED)
    rng, rows = np.random.default_rng(SEED), list[tuple[str, bool]]()
    for n in range(given.runs):
        rows += inside(rng)
        print(f"  {n + 1} of {given.runs}", flush=True)
    shares = {key: [int(ok) for name, ok in rows if name == key] for key, _ in rows}
    count, within = len(rows), sum(ok for _, ok in rows)
    low, high = wilson(within, count)
    shown = [(key, f"{sum(axes)} of {len(axes)} axes") for key, axes in shares.items()]
    shown.append(("all", f"{within} of {count} axes, {100 * low:.1f} to {100 * high:.1f} % (95 %)"))
    finish("foretold", {"axes": float(count), "inside": within / max(1, count)}, shown, RESULTS)


if __name__ == "__main__":
    main()
