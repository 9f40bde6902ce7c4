"""Jobs whose workers are lost, and answers that are late or come twice."""

from __future__ import annotations

import pytest

from rtc.protocol.outcomes import OutcomeKind, RefusalReason
from tests.broker.harness import Harness, record


@pytest.mark.parametrize(
    ("reach", "job", "phase"),
    [
        ("says", "C-1/1 parser", "parsing"),
        ("parsed", "C-1/2 elaborator", "elaborating"),
        ("elaborated", "C-1/3 binder", "binding"),
    ],
)
def test_a_lost_job_is_given_out_again(reach, job, phase):
    s = Harness()
    getattr(s, reach)(*["X"] if reach == "says" else [])
    assert s.loses_worker("C-1") == [f"note C-1 {phase}", f"job {job} #2"]


def test_a_lost_analysis_is_done_again_under_the_same_lease():
    s = Harness()
    s.analyzing()
    assert s.loses_worker("C-1") == ["note C-1 analyzing", "job C-1/4 analyzer #2 lease RIGHT-ARM"]


def test_three_deaths_are_poison_and_name_the_evidence():
    s = Harness()
    s.says("X")
    s.loses_worker("C-1")
    s.loses_worker("C-1")
    assert s.loses_worker("C-1") == ["note C-1 ended", "end C-1 refused"]
    assert s.outcome("C-1").refusal.reason is RefusalReason.POISON
    assert s.outcome("C-1").refusal.cause.deaths[2] == "worker: exit -9"
    assert len(s.outcome("C-1").refusal.cause.deaths) == 3


def test_a_job_that_only_lay_with_a_dead_worker_is_not_blamed():
    s = Harness()
    s.says("X")
    for _ in range(10):
        s.loses_worker("C-1", blamed=False)
    assert s.phase("C-1") == "parsing"


def test_a_poisoned_analysis_fails_the_command():
    s = Harness()
    s.analyzing()
    for _ in range(3):
        s.loses_worker("C-1")
    assert s.outcome("C-1").kind is OutcomeKind.FAILED


def test_late_and_double_answers_change_nothing():
    s = Harness()
    s.says("X")
    s.loses_worker("C-1")
    assert s.answers("C-1", record(), attempt=1) == []  # the worker thought dead
    s.answers("C-1", record())
    assert s.answers("C-1", record(), job="C-1/1", attempt=2) == []  # the answer twice
    assert s.answers("C-9", record(), job="C-9/1") == []
    assert s.state.counts["stale"] == 3
    assert s.phase("C-1") == "elaborating"
