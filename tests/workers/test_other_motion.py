"""What stands in for a motion that cannot be planned: no other kind of motion, if the sentence or a load forbids it."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from rtc.protocol.messages import Script
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.sentence import ParsedCommand
from tests.workers.conftest import GRAMMAR, Bench, record
from workers.elaborator.other_motion import sentence_of
from workers.parser.parse import parse_job

AT_LIMIT = "MOVE RIGHT-ARM TO JOINTS 0 110 -160 0 50 260 DEG JOINT-MOTION"  # joint_6 ends at 266 deg
TURN = "MOVE RIGHT-ARM BY 20 DEG ALONG TOOL-Z"


@pytest.fixture
def at_limit(bench: Bench) -> Bench:
    assert bench.do(AT_LIMIT).succeeded
    return bench


def test_a_straight_step_that_becomes_a_swing_says_so_first(at_limit: Bench) -> None:
    run = at_limit.do(TURN)
    assert run.succeeded
    remark = run.assessments[-1].remark
    assert remark.startswith("a relative step, joint-interpolated, not a relative step in a straight line: ")
    assert "joint_6" in remark
    assert "the hand travels 0.49 m" in remark


def test_what_is_asked_for_says_nothing(at_limit: Bench) -> None:
    assert "not a relative step" not in at_limit.do(f"{TURN} JOINT-MOTION").assessments[-1].remark


@pytest.mark.parametrize(
    "clauses",
    [
        "GUARDED",
        "UNLESS FORCE EXCEEDS 10 N THEN STOP",
        "MAINTAIN AVOID-NEIGHBORS BY 5 MM AND SPEED 5 CM/S GUARDED UNLESS FORCE EXCEEDS 8 N THEN BACK-OFF BY 2 CM",
    ],
)
def test_a_watched_step_is_refused_with_the_sentence_that_asks_for_the_swing(at_limit: Bench, clauses: str) -> None:
    refused = at_limit.elaborate(f"{TURN} {clauses}")
    assert isinstance(refused, Refusal)
    assert refused.reason is RefusalReason.INFEASIBLE
    assert (refused.cause.arm, refused.cause.joint) == ("RIGHT-ARM", "joint_6")
    (advised,) = refused.clears[0].sentences
    asked = f"{TURN} JOINT-MOTION {clauses}"
    assert record(advised) == record(asked)
    assert isinstance(at_limit.elaborate(advised), Script)


def test_a_load_is_not_swung(bench: Bench) -> None:
    for sentence in ("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM"):
        assert bench.do(sentence).succeeded
    refused = bench.elaborate("MOVE RIGHT-ARM BY 40 CM ALONG Z")  # straight up, joint_4 meets its limit
    assert isinstance(refused, Refusal)
    assert (refused.cause.arm, refused.cause.joint) == ("RIGHT-ARM", "joint_4")
    assert refused.clears[0].sentences == ["MOVE RIGHT-ARM BY 400 MM ALONG Z JOINT-MOTION"]
    assert isinstance(bench.elaborate("MOVE RIGHT-ARM BY 40 CM ALONG Z JOINT-MOTION"), Script)


@pytest.mark.parametrize(
    "sentence",
    [
        "MOVE RIGHT-ARM TO CLEAR-POINT-1 MAINTAIN POSE-DURING-MOTION LEVEL AND SPEED 5 CM/S GUARDED",
        "MOVE RIGHT-ARM TO JOINTS 0 110 -160 0 50 260 DEG UNLESS CONTACT THEN STOP AND TRY REGRASP",
        "MOVE RIGHT-ARM TO POSITION 80 -80 60 CM UNLESS TORQUE EXCEEDS 3 NM THEN COMPLY",
        "MOVE ARM THIRD BY -2.5 CM ALONG UP GUARDED",
        "CARRY MACS-NEW TO BAY-2 THROUGH CLEAR-POINT-1 WITH RIGHT-ARM MAINTAIN GRIP-FORCE 30 N",
    ],
)
def test_the_sentence_of_a_record_has_that_record(sentence: str) -> None:
    asked = replace(record(sentence), path="straight_line")
    again = parse_job(GRAMMAR, sentence_of(asked))
    assert isinstance(again, ParsedCommand)
    assert again == asked
