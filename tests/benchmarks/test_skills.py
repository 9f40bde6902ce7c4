"""How runs of several verbs share their first sentences, what is counted, and how runs are joined."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks import skills
from benchmarks.copies import in_copies
from benchmarks.skills import ALIGNED, GRASPED, HELD, SCENES, SkillRun, Trial
from rtc.protocol.messages import Fact, Validity
from rtc.world.model import LOOSE
from tests.campaigns.against_truth import judge

OF_MODULE = [verb for verb, scene in SCENES.items() if scene.root == SCENES["GRASP"].root]


class Spoken(Trial):
    """A trial without physics: each sentence ends as stated, and is noted in a file that all copies share."""

    def __init__(self, notes: Path, ends: dict[str, bool | None]) -> None:
        self.notes, self.ends = notes, ends  # sentence -> whether its advice repaired it; absent: it succeeds
        self.run = SkillRun("", 3, [])
        self.subsystem: Any = SimpleNamespace(close_eyes=lambda: None)

    def _done(self, sentence: str) -> bool:
        with self.notes.open("a") as file:
            file.write(f"{sentence}\n")
        if sentence not in self.ends:
            return True
        self.run.stage, self.run.cause, self.run.repaired = sentence, "slipped", self.ends[sentence]
        return False


@pytest.fixture
def spoken(tmp_path: Path) -> Callable[..., tuple[dict[str, SkillRun], Counter[str]]]:
    def perform(**ends: Any) -> tuple[dict[str, SkillRun], Counter[str]]:
        trial = Spoken(tmp_path / "notes", ends.get("ends", {}))
        runs = trial._branch(OF_MODULE, 0)
        assert sorted(run.verb for run in runs) == sorted(OF_MODULE)
        return {run.verb: run for run in runs}, Counter(trial.notes.read_text().splitlines())

    return perform


def test_each_sentence_of_a_number_is_performed_once(spoken: Any) -> None:
    runs, given = spoken()
    assert all(run.succeeded for run in runs.values())
    assert set(given.values()) == {1}
    assert set(given) == {sentence for verb in OF_MODULE for sentence in SCENES[verb].sentences}


def test_a_failed_sentence_counts_for_each_verb_behind_it(spoken: Any) -> None:
    runs, given = spoken(ends={HELD[-1]: False})
    behind = {verb for verb in OF_MODULE if HELD[-1] in SCENES[verb].sentences}
    assert {verb for verb, run in runs.items() if not run.succeeded} == behind
    assert {runs[verb].stage for verb in behind} == {HELD[-1]}
    assert ALIGNED[-1] not in given


def test_a_repaired_sentence_fails_its_own_verb_alone(spoken: Any) -> None:
    runs, _ = spoken(ends={GRASPED[-1]: True})
    assert {verb for verb, run in runs.items() if not run.succeeded} == {"GRASP"}
    assert runs["PUSH"].repaired


def test_runs_of_parts_are_counted_once_and_the_newest_holds(tmp_path: Path) -> None:
    failed = SkillRun("PUSH", 1, [], stage=HELD[-1], cause="slipped", repaired=False)
    mended = SkillRun("PUSH", 1, [], succeeded=True)
    for name, runs in (("a", [failed, SkillRun("PULL", 1, [], succeeded=True)]), ("b", [mended])):
        (tmp_path / name).write_text(json.dumps([asdict(run) for run in runs]))
    done = skills.joined([tmp_path / "a", tmp_path / "b"])
    assert [(run.verb, run.succeeded) for run in done] == [("PUSH", True), ("PULL", True)]


def test_the_lowest_rate_is_of_the_verb_with_the_fewest_successes() -> None:
    done = [SkillRun("PULL", n, [], succeeded=True) for n in range(2)]
    done += [SkillRun("PUSH", 0, [], succeeded=True), SkillRun("PUSH", 1, [], stage="PUSH", repaired=True)]
    metrics, rows = skills.metrics_of(done)
    assert metrics["lowest_rate"] == 0.5
    assert metrics["repaired_rate"] == 1.0
    assert dict(rows)["PULL"].startswith("2 of 2")


def _square(number: int) -> tuple[int, int]:
    if number == 9:
        os._exit(7)
    return number * number, os.getpid()


def test_work_is_done_in_copies_of_this_process() -> None:
    found = list(in_copies(_square, [1, 2, 3], processes=2))
    assert sorted(square for square, _ in found) == [1, 4, 9]
    assert len({process for _, process in found} | {os.getpid()}) == 4


def test_a_copy_that_ends_without_a_result_is_an_error() -> None:
    with pytest.raises(RuntimeError, match="no result of 9"):
        list(in_copies(_square, [1, 9]))


@pytest.mark.parametrize(
    ("key", "value", "wrong"),
    [("turns", 7.8, False), ("turns", 7.2, True), ("state", LOOSE, False), ("state", "TURNED", False)],
)
def test_the_turns_of_a_bolt_are_compared_with_the_truth(key: str, value: Any, wrong: bool) -> None:
    fact = Fact(key=f"BOLT-1.{key}", value=value, validity=Validity.VALID, version=1, source="C-1", at_s=0.0)
    assert bool(judge([fact], {"turns": {"BOLT-1": (8.0, 8.0)}}).wrong) == wrong


def test_a_bolt_that_is_still_in_its_thread_is_not_loose() -> None:
    fact = Fact(key="BOLT-1.state", value=LOOSE, validity=Validity.VALID, version=1, source="C-1", at_s=0.0)
    assert judge([fact], {"turns": {"BOLT-1": (6.0, 8.0)}}).wrong
