"""Exact arms refuse what must give way before anything moves, and perform what they can to the end."""

from __future__ import annotations

import pytest

from rtc.model.cells.cell import Cell
from rtc.protocol.advice import sentences_of
from rtc.protocol.causes import ExactArm
from rtc.protocol.messages import Script
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.wording.advice import in_one_line
from tests.workers.conftest import MODEL, Bench, Kinematic, Reporter
from workers.planning.robot_models import CellModel

SERVICING = CellModel(Cell.load("servicing"))
ARMS = ["LEFT-ARM", "RIGHT-ARM"]
GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"
LIFTED = [GRASP, "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM"]


@pytest.mark.parametrize(
    ("model", "before", "sentence"),
    [
        (SERVICING, ["GRASP LEFT-END-EFF DOOR-2 LATCH-PULL"], "OPEN DOOR-2 BY 60 DEG WITH LEFT-ARM"),
        (SERVICING, ["GRASP LEFT-END-EFF DOOR-2 LATCH-PULL"], "TURN DOOR-2 BY 30 DEG WITH LEFT-ARM"),
        (SERVICING, ["GRASP RIGHT-END-EFF POWER-DRIVER TOOL-GRIP"], "LOOSEN BOLT-1 WITH RIGHT-ARM"),
        (MODEL, LIFTED, "CARRY MACS-NEW TO BAY-2-FRONT WITH BOTH-ARMS"),
        (MODEL, LIFTED, "INSERT MACS-NEW INTO BAY-2 WITH RIGHT-ARM"),
    ],
)
def test_what_must_give_way_is_refused_by_exact_arms_alone(model, before, sentence) -> None:
    bench = Bench(Reporter(model.cell), model)
    for one in before:
        bench.rigid = ARMS
        assert bench.do(one).succeeded, one
    bench.rigid = []
    assert isinstance(bench.elaborate(sentence), Script)
    bench.rigid = ARMS
    refusal = bench.elaborate(sentence)
    assert isinstance(refusal, Refusal)
    assert refusal.reason is RefusalReason.INFEASIBLE
    assert refusal.cause in [ExactArm(arm=arm) for arm in ARMS]
    assert "rtc up --mcm bullet" in in_one_line(refusal.clears)


@pytest.mark.parametrize(
    ("sentence", "words"),
    [
        ("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A MAINTAIN STIFFNESS 400 N/M", "MAINTAIN STIFFNESS"),
        ("STOW RIGHT-ARM MAINTAIN STIFFNESS 400 N/M", "MAINTAIN STIFFNESS"),
        ("HOLD RIGHT-ARM FOR 1 SEC MAINTAIN STIFFNESS 800 N/M", "MAINTAIN STIFFNESS"),
        ("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A UNLESS FORCE EXCEEDS 20 N THEN COMPLY", "THEN COMPLY"),
        ("OPEN RIGHT-END-EFF UNLESS FORCE EXCEEDS 20 N THEN COMPLY", "THEN COMPLY"),
    ],
)
def test_what_the_sentence_asks_to_give_way_is_refused_before_anything_moves(sentence, words) -> None:
    bench = Bench(Reporter(MODEL.cell))
    assert isinstance(bench.elaborate(sentence), Script)
    bench.rigid = ARMS
    refusal = bench.elaborate(sentence)
    assert isinstance(refusal, Refusal)
    assert refusal.where == words
    assert f"leave out {words}" in in_one_line(refusal.clears)
    assert isinstance(bench.elaborate(sentence.split(" MAINTAIN ")[0].split(" UNLESS ")[0]), Script)


@pytest.mark.physics
def test_what_exact_arms_can_do_is_accepted_and_done() -> None:
    bench = Bench(Kinematic())
    bench.rigid = ARMS
    for sentence in (
        GRASP,
        "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM",
        "CARRY MACS-NEW TO BAY-2-FRONT WITH RIGHT-ARM",
        "MOVE RIGHT-ARM BY 5 CM ALONG UP",
        "CARRY MACS-NEW TO RACK-1-FRONT WITH RIGHT-ARM",
        "PLACE MACS-NEW ON RACK-1 WITH RIGHT-ARM",
        "STOW RIGHT-ARM",
    ):
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.failure)


@pytest.mark.parametrize(
    "sentence",
    [
        "PUSH MACS-NEW BY 3 CM",
        "PULL MACS-NEW BY 3 CM",
        "INSERT MACS-NEW INTO BAY-2",
        "CARRY MACS-NEW TO BAY-2-FRONT WITH BOTH-ARMS",
    ],
)
def test_no_other_form_is_advised_that_exact_arms_refuse_too(sentence) -> None:
    """PUSH BY 20 MM was advised instead, then BY 10 MM; INSERT INTO RACK-1, then INTO BAY-2 again."""
    bench = Bench(Reporter(MODEL.cell))
    bench.rigid = ARMS
    for one in LIFTED:
        assert bench.do(one).succeeded, one
    refusal = bench.do(sentence).refusal
    assert isinstance(refusal.cause, ExactArm)
    for advised in sentences_of(refusal.clears):
        assert isinstance(bench.elaborate(advised), Script), advised
