"""Figures that a hand limits, and joint values of an arm with joints that slide."""

from __future__ import annotations

import msgspec
import pytest

from rtc.model.cells.cell import Cell
from rtc.protocol.advice import sentences_of
from rtc.protocol.messages import HandStep, WorldChange
from rtc.protocol.outcomes import Refusal
from rtc.world.model import World, initial_facts
from tests.workers.conftest import CELL, Bench, record
from workers.analyzer import analyze as analyzer
from workers.planning import in_seat
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery


def test_a_smaller_and_weaker_hand_opens_and_grips_as_it_can(bench: Bench) -> None:
    gripper = msgspec.structs.replace(CELL.arms[0].gripper, max_opening_m=0.06, max_force_n=25.0)
    arm = msgspec.structs.replace(CELL.arms[0], gripper=gripper)
    model = CellModel(msgspec.structs.replace(CELL, arms=[arm, CELL.arms[1]]))
    script = bench.elaborate("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", model)
    assert not isinstance(script, Refusal), script
    hands = [step for step in script.steps if isinstance(step, HandStep)]
    assert next(each.width_m for each in hands if each.width_m) == pytest.approx(0.056)  # 2 mm before its stops
    assert {each.grip_n for each in hands if each.grip_n} == {25.0}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ("50 CM -5 CM 0 110 -160 0 50 0 DEG", ""),
        ("50 -5 0 110 -160 0 50 0 DEG", "rail_y of GANTRY slides"),
        ("50 CM -5 CM 2 CM 110 -160 0 50 0 DEG", "joint_1 of GANTRY turns"),
        ("0.5 -0.05 0 1.9 -2.8 0 0.9 0", "rail_y of GANTRY slides"),
        ("110 -160 0 DEG", "has 8 joints"),
    ],
)
def test_a_joint_that_slides_takes_a_length(bench: Bench, values: str, words: str) -> None:
    cell = Cell.load("gantry")
    bench.world = World().overlay(initial_facts(cell))
    found = bench.elaborate(f"MOVE ARM GANTRY TO JOINTS {values}", CellModel(cell))
    assert isinstance(found, Refusal) == bool(words), found
    if isinstance(found, Refusal):
        assert words in found.message  # wording: which joint, and what it takes


def test_a_hand_whose_name_is_no_word_is_refused_with_the_sentence_that_opens_it(bench: Bench) -> None:
    cell = Cell.load("gantry")
    bench.world = World().overlay(initial_facts(cell))
    found = bench.elaborate(f"OPEN {cell.arms[0].end_effector}", CellModel(cell))
    assert isinstance(found, Refusal)
    assert sentences_of(found.clears) == ["OPEN ARM GANTRY"]
    assert not isinstance(bench.elaborate("OPEN ARM GANTRY", CellModel(cell)), Refusal)


def test_the_way_out_of_a_seat_names_a_further_arm_as_a_sentence_does(bench: Bench) -> None:
    cell = Cell.load("gantry")
    module = next(thing for thing in cell.objects if thing.seat)
    facts = World().overlay(initial_facts(cell))
    bench.world = facts.overlay([WorldChange(key="GANTRY.holding", value=module.name)])
    query = WorldQuery(CellModel(cell), bench.world)
    sentence = in_seat.way_out_in_words(query, "GANTRY", module.seat or "")
    assert sentence.endswith("WITH ARM GANTRY")
    assert record(sentence).hand == "GANTRY"


@pytest.mark.parametrize("advice", ["unseen", "out_of_sight"])
def test_the_advice_for_a_body_that_no_camera_saw_begins_with_what_can_be_done(bench: Bench, advice: str) -> None:
    program = analyzer.compile(bench.programs["analyzer"])
    outcome = program.classes[advice]
    first = (outcome.again or outcome.clears)[0]
    assert (first.sentences, first.states) in ((["TRACK {object}"], []), ([], ["{object}.frame"]))
