"""The queries of the planning benchmark are solvable problems, and the same ones each time."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.load.planning_queries import Queries
from benchmarks.peers import direct_ways
from benchmarks.planning import Figures, Tally, _metrics, _to_goal
from rtc.spatial import geometry
from workers.planning.motion.request import fault, free_posture
from workers.planning.robot_models import CellModel


@pytest.fixture(scope="module")
def model(cell):
    return CellModel(cell)


@pytest.mark.parametrize("attitude", ["", "LEVEL"])
def test_starts_and_goals_are_free(model, cell, attitude):
    for query in Queries(model, "LEFT-ARM", 1, attitude).take(12):
        test = free_posture(query.request)
        for q in (query.request.start, *query.goals):
            assert test(q) is None
            assert query.request.arm.limit_margin_rad(q) >= query.request.margin_rad - 1e-9
        if attitude:
            assert geometry.angle(query.request.arm.fk(query.goal), cell.attitudes[attitude].pose) < 1e-6


def test_a_seed_gives_the_same_queries_again(model):
    first, again, other = ([query.goal for query in Queries(model, "RIGHT-ARM", seed).take(4)] for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_the_figures_count_what_was_found(model):
    figures = Figures()
    for n, query in enumerate(Queries(model, "RIGHT-ARM", 1).take(6)):
        path = figures.ours.run(query, _to_goal if n else lambda _: None)
        assert path is None if n == 0 else fault(query.request, path) is None
        figures.drawn.append(n)
        figures.direct.run(query, lambda q: direct_ways.find(q.request, q.goal))
    figures.missed = 1
    metrics = _metrics(figures)
    assert metrics["success_percent"] == pytest.approx(100 * 5 / 6)
    assert metrics["of_reachable_percent"] == pytest.approx(100 * 5 / 6)
    assert metrics["vs_ompl_pybullet"] is None
    assert isinstance(figures.level, Tally)
