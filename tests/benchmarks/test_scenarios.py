"""The jobs that the workers are timed with are real ones: of every kind, and some that cannot be done."""

from __future__ import annotations

import random

import pytest

from benchmarks.load.scenarios import Scenario, Workers, changed
from rtc.model.cells.cell import Cell
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import Refusal


@pytest.fixture(scope="module")
def workers():
    return Workers(Cell.load("swapout"))


@pytest.fixture
def scenario(workers):
    return Scenario(workers, random.Random(1))


def test_a_sentence_that_is_carried_out_leaves_a_job_for_each_worker_and_changes_the_world(scenario):
    before = scenario.world
    assert scenario.run("MOVE LEFT-ARM TO BAY-2-FRONT")
    assert [job.kind for job in scenario.jobs] == list(WorkerKind)
    assert all(job.world is before for job in scenario.jobs)
    assert scenario.world.facts["LEFT-ARM.joints"] != before.facts["LEFT-ARM.joints"]


def test_a_job_gives_the_same_whenever_it_is_done(workers, scenario):
    scenario.run("STOW RIGHT-ARM")
    first, again = ([workers.do(job) for job in scenario.jobs] for _ in range(2))
    assert first == again


def test_what_cannot_be_done_ends_its_sentence(workers, scenario):
    assert not scenario.run("MOVE LEFT-ARM TO RACK-1-FRONT")
    assert isinstance(workers.do(scenario.jobs[-1]), Refusal)


def test_a_step_can_be_asked_again_in_a_world_where_all_but_its_arm_stands_elsewhere(workers, scenario):
    assert scenario.run("APPROACH MACS-NEW WITH RIGHT-ARM")
    step = [job for job in scenario.jobs if job.kind is WorkerKind.BINDER][-1]
    later = changed(step, workers.model.cell, random.Random(2))
    assert later.data == step.data
    assert later.world.facts["LEFT-ARM.joints"] != step.world.facts["LEFT-ARM.joints"]
    assert later.world.facts["RIGHT-ARM.joints"] == step.world.facts["RIGHT-ARM.joints"]
