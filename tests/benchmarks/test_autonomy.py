"""What the autonomy figure counts, and how runs are joined."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path

import pytest

from benchmarks import autonomy
from benchmarks.autonomy import MODULES, MOST_M, MOST_RAD, STAGES, AutonomyRun
from examples.swapout import lines, swapout
from rtc.protocol.outcomes import StopReason
from rtc.wording.advice import in_one_line
from tests.campaigns import advice
from tests.campaigns.advice import Answer
from tests.workers.conftest import Bench, Reporter


def test_a_number_has_the_same_errors_within_their_limits() -> None:
    drawn = [autonomy.drawn(number) for number in range(200)]
    assert drawn[7] == autonomy.drawn(7) != drawn[8]
    for axis, most in enumerate([MOST_M] * 3 + [MOST_RAD] * 3):
        errors = [one[module][axis] for one in drawn for module in MODULES]
        assert max(map(abs, errors)) <= most
        assert math.sqrt(sum(e * e for e in errors) / len(errors)) == pytest.approx(most / 3.0, rel=0.25)


def test_each_line_of_a_stage_is_one_of_the_demo() -> None:
    known = {line.label for line in lines.read(swapout.LINES.read_text())}
    assert {label for labels in STAGES.values() for label in labels} <= known


def test_a_surrender_is_clean_with_a_cause_and_an_advice_and_arms_at_rest() -> None:
    surrendered = AutonomyRun(0, {}, reached=["door"], line="C6", cause="blocked", advice="STOW LEFT-ARM")
    assert surrendered.clean
    assert not surrendered.succeeded
    for broken in ({"advice": ""}, {"cause": ""}, {"restless": "STOW LEFT-ARM"}):
        assert not AutonomyRun(**{**asdict(surrendered), **broken}).clean


def test_a_run_whose_module_is_not_seated_is_neither_success_nor_clean() -> None:
    run = AutonomyRun(0, {}, reached=list(STAGES), unseated="MACS-NEW 9 mm from BAY-2")
    assert not run.succeeded
    assert not run.clean


def test_runs_of_shards_are_counted_once(tmp_path: Path) -> None:
    good = AutonomyRun(0, {}, reached=list(STAGES))
    bad = AutonomyRun(1, {}, reached=["door", "bolts"], line="C16", cause="no way", advice="LOCATE MACS-OLD")
    for name, runs in (("a", [good, bad]), ("b", [bad])):
        (tmp_path / name).write_text(json.dumps([asdict(run) for run in runs]))
    metrics, rows = autonomy.metrics_of(autonomy._joined([tmp_path / "a", tmp_path / "b"]))
    assert metrics["runs"] == 2
    assert metrics["success_rate"] == 0.5
    assert ("reached: extraction", "1 of 2") in rows
    assert ("surrendered, 1 x", "C16: no way") in rows


def test_the_answer_of_a_failed_sentence_names_the_operator_whom_no_planner_asks() -> None:
    reporter = Reporter()
    reporter.instead["C-1.1"] = StopReason.FORCE_LIMIT
    bench = Bench(reporter)
    answer = Answer.of(bench.do("MOVE RIGHT-ARM TO CLEAR-POINT-1"))
    assert not answer.succeeded
    asked = "MOVE RIGHT-ARM TO CLEAR-POINT-1 VIA OPERATOR-INTERVENTION"
    assert answer.clears[-1].sentences == [asked]
    assert not any(asked in advice.sentences(one, dict) for one in answer.clears)
    run = AutonomyRun(0, {}, reached=["door"], line="C26", cause=answer.message, advice=in_one_line(answer.clears))
    assert autonomy.metrics_of([run])[0]["operator_offered"] == 1
