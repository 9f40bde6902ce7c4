"""Where a held object truly is, after motions that were drawn, and what its fact states."""

from __future__ import annotations

import random

import pytest

from rtc.model.cells.cell import Cell
from rtc.spatial import geometry
from tests.workers.conftest import Bench, Physical
from workers.planning import pose_spread
from workers.planning.robot_models import CellModel

TURNS, LINES = ("TOOL-X", "TOOL-Y"), ("X", "Y", "Z")
LOOSE_M, LOOSE_RAD = 1e-5, 1e-4  # of what a report rounds


@pytest.mark.physics
@pytest.mark.timeout(300)
def test_the_truth_is_within_the_stated_spread_after_drawn_motions() -> None:
    """In 90 % of all axes. Turns under gravity moved the cube by a degree in the hand, where 0.1 were stated: 32 of 36
    axes were within."""
    rng, cell = random.Random(138), Cell.load("panda")
    subsystem = Physical(cell)
    bench = Bench(subsystem, CellModel(cell))
    inside: list[bool] = []
    drawn = [f"MOVE ARM PANDA BY {rng.choice((-1, 1)) * rng.randint(15, 30)} DEG ALONG {axis}" for axis in TURNS]
    drawn += [f"MOVE ARM PANDA BY {rng.randint(5, 15)} CM ALONG {axis}" for axis in LINES[1:]]
    try:
        for sentence in ("GRASP CUBE-1 TOP WITH ARM PANDA VIA SIMPLE", "LIFT CUBE-1 BY 15 CM", *drawn):
            run = bench.do(sentence)
            assert run.succeeded, (sentence, run.refusal, run.failure)
            fact, truth = bench.world.get("CUBE-1.grasp"), subsystem.truth()
            true = geometry.relative(truth["tcp"]["PANDA"], truth["poses"]["CUBE-1"])
            errors, loose = pose_spread.error_of(fact.value, true), [LOOSE_M] * 3 + [LOOSE_RAD] * 3
            spread = fact.spread or [0.0] * 6
            inside += [abs(e) <= s + t for e, s, t in zip(errors, spread, loose, strict=True)]
    finally:
        subsystem.close()
    assert sum(inside) >= 0.9 * len(inside)
