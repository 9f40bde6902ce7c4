"""SHOW, DESCRIBE, VIA a strategy, SET of a default strategy: sentences about the facts and the programs."""

from __future__ import annotations

from typing import Any

import pytest

from rtc.protocol.advice import sentences_of
from rtc.protocol.outcomes import Refusal, RefusalReason
from tests.refusals import stated
from tests.workers.conftest import Bench, record

TAKE = "GRASP MACS-NEW WITH RIGHT-ARM"


def answer(bench: Bench, sentence: str) -> str:
    run = bench.do(sentence)
    assert run.succeeded, (run.refusal, run.failure)
    assert run.primitives == []
    return run.assessments[-1].remark


def script_of(bench: Bench, sentence: str) -> str:
    made: Any = bench.elaborate(sentence)
    assert not isinstance(made, Refusal), made
    return str(made.context.script)


@pytest.mark.parametrize(
    ("sentence", "words"),
    [
        ("SHOW RIGHT-ARM", ["joints", "RIGHT-END-EFF", "holds MACS-NEW"]),
        ("SHOW BOTH-ARMS", ["RIGHT-ARM: ", "LEFT-ARM: "]),
        ("SHOW MACS-NEW", ["held by RIGHT-ARM", "in RACK-1"]),
        ("SHOW RACK-2", ["holds MACS-OLD"]),
        ("SHOW RESOURCES", ["RIGHT-ARM", "CAMERA-1", "RACK-1"]),
        ("DESCRIBE INSERT-SCRIPT", ["skill (case 4)", "seat_free", "realign-1"]),
        ("DESCRIBE CENTERING-GRASP", ["grasp-centering", "vision (retry_step)"]),
        ("DESCRIBE EXTRACT-SCRIPT", ["out of the seat"]),
        ("DESCRIBE GRASP-ENTRY", ["LEFT-END-EFF"]),
        ("DESCRIBE WIGGLE", ["to either side"]),
        ("DESCRIBE MACS-OLD", ["module", "2 kg", "HANDLE-A (20 mm)"]),
        ("DESCRIBE RIGHT-ARM", ["6 joints", "2.5 kg"]),
        ("DESCRIBE BAY-2-FRONT", ["a place of RIGHT-ARM, LEFT-ARM"]),
    ],
)
def test_a_question_is_answered_in_words(bench: Bench, sentence: str, words: list[str]) -> None:
    assert bench.do(f"{TAKE} VIA SIMPLE").succeeded
    given = answer(bench, sentence)
    assert [word for word in words if word not in given] == []


def test_a_taught_place_is_shown_in_the_units_of_an_arm(bench: Bench) -> None:
    assert bench.do("SET P1 POSTURE-OF-RIGHT-ARM HERE").succeeded
    joints = answer(bench, "SHOW RIGHT-ARM").partition("; tcp")[0].partition(": ")[2]
    assert answer(bench, "SHOW P1") == f"P1: RIGHT-ARM with {joints}"
    assert bench.do("SET P1 POSTURE-OF-RIGHT-ARM NONE").succeeded
    assert bench.do("SHOW P1").refusal is not None


@pytest.mark.parametrize("sentence", ["SHOW RACK-3", "DESCRIBE MACS-NEU", "SHOW C-7"])
def test_a_question_about_nothing_names_what_there_is(bench: Bench, sentence: str) -> None:
    refusal = bench.do(sentence).refusal
    assert refusal is not None
    assert refusal.reason is RefusalReason.NAME
    assert {"RIGHT-ARM", "MACS-NEW"} <= set(refusal.expected)


@pytest.mark.parametrize("name", ["SIMPLE", "GRASP-SIMPLE", "SIMPLE-GRASP"])
def test_via_chooses_the_strategy_of_a_verb(bench: Bench, name: str) -> None:
    assert script_of(bench, TAKE) == "grasp-centering"
    assert script_of(bench, f"{TAKE} VIA {name}") == "grasp-simple"


@pytest.mark.parametrize(
    ("via", "facts", "expected"),
    [
        ("SECOND", {"reason": RefusalReason.NO_SCRIPT, "where": "performer"}, "GRASP-SIMPLE"),  # no other hand holds it
        ("MAGIC", {"what": "GRASP strategy", "name": "MAGIC"}, "GRASP-CENTERING"),
        ("CAMERA-1", {"what": "GRASP strategy", "name": "CAMERA-1"}, "GRASP-FEELING"),
    ],
)
def test_a_strategy_that_does_not_fit_is_refused_with_those_that_do(
    bench: Bench, via: str, facts: dict[str, Any], expected: str
) -> None:
    refusal = bench.do(f"{TAKE} VIA {via}").refusal
    assert refusal is not None
    assert stated(refusal, facts) == facts
    assert expected in refusal.expected


@pytest.mark.parametrize(
    "sentence",
    ["MOVE RIGHT-ARM TO BAY-2-FRONT VIA SIMPLE", "SET LIFT-STRATEGY DEFAULT SIMPLE", "SET LIFT-STRATEGY COLOUR RED"],
)
def test_only_names_of_strategies_that_a_sentence_can_have_are_listed(bench: Bench, sentence: str) -> None:
    """MOVE, LIFT and OPERATOR were listed, which are reserved words."""
    refusal = bench.do(sentence).refusal
    assert refusal is not None
    words = sentence.rpartition(" ")[0]
    for name in refusal.expected:
        assert record(f"{words} {name}"), name
    for advised in sentences_of(refusal.clears):
        assert record(advised), advised


def test_the_default_strategy_is_tried_first_until_it_is_forgotten(bench: Bench) -> None:
    assert bench.do("SET GRASP-STRATEGY DEFAULT SIMPLE").succeeded
    assert script_of(bench, TAKE) == "grasp-simple"
    assert script_of(bench, f"{TAKE} VIA CENTERING") == "grasp-centering"
    assert "SIMPLE" in answer(bench, "SHOW GRASP-STRATEGY")
    assert bench.do("SET GRASP-STRATEGY DEFAULT NONE").succeeded
    assert script_of(bench, TAKE) == "grasp-centering"


@pytest.mark.parametrize(
    ("sentence", "facts"),
    [
        ("SET GRASP-STRATEGY DEFAULT MAGIC", {"what": "GRASP strategy", "name": "MAGIC"}),
        ("SET GRASP-STRATEGY LIKELIHOOD 1", {"reason": RefusalReason.SENTENCE, "where": "LIKELIHOOD"}),
        ("SET DANCE-STRATEGY DEFAULT SIMPLE", {"what": "object or seat", "name": "DANCE-STRATEGY"}),
    ],
)
def test_a_wrong_default_is_refused(bench: Bench, sentence: str, facts: dict[str, Any]) -> None:
    refusal = bench.do(sentence).refusal
    assert refusal is not None
    assert stated(refusal, facts) == facts
