"""Random plans of the planner, judged by coal alone; and the judge finds what is wrong on purpose."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.load.planning_queries import Queries
from rtc.model.cells.cell import Cell
from tests.campaigns.random_plans import SEED, Judge, judged
from tests.workers.conftest import MODEL
from workers.planning.motion.path import joint_line
from workers.planning.motion.plan import Motion
from workers.planning.motion.request import is_free
from workers.planning.motion.timing import time_path


@pytest.mark.parametrize("cell", ["swapout", "servicing"])
def test_coal_alone_refuses_no_accepted_path(cell):
    counts = judged(Cell.load(cell), runs=40, level=25).counts
    assert counts["plans"] > 30
    assert counts["pairs"] > 0
    assert (counts["not free"], counts["pairs that meet"]) == (0, 0)


def test_the_judge_finds_a_line_through_a_body():
    judge = Judge(MODEL.cell)
    found = []
    for query in Queries(MODEL, "RIGHT-ARM", SEED).take(20):
        line = joint_line(query.request.start, query.goal)
        motion = Motion(line, time_path(query.request.arm, line), query.goal, np.zeros(7))
        found.append((is_free(query.request, line), not judge.is_hit(query.request, motion)))
    assert {free for free, _ in found} == {True, False}
    assert all(free == judged_free for free, judged_free in found)


def test_the_judge_finds_two_arms_that_meet(monkeypatch):
    """Nothing makes the later motion wait."""
    monkeypatch.setattr("workers.planning.motion.beside.start_conditions", lambda *given, **how: [])
    assert any(judged(MODEL.cell, runs, level=0).counts["pairs that meet"] for runs in (50, 400))
