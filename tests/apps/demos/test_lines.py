"""The lines of the swap-out: what they are, and which of them a planner gives at once."""

from __future__ import annotations

import pytest

from rtc.apps.demos import lines, swapout
from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import OutcomeKind
from tests.workers.conftest import record

CELL = Cell.load(swapout.CELL)
LINES = lines.read(swapout.LINES.read_text())
NEEDED = lines.waits(LINES, CELL, swapout.AFTER)
VERBS = """TEST TEST LOCATE LOCATE GRASP GRASP OPEN HOLD LOCATE APPROACH LOOSEN LOOSEN LOOSEN VERIFY PLACE GRASP EXTRACT
ABORT RELEASE HANDOFF PLACE GRASP TRACK EXTRACT CARRY STOW MOVE INSERT VERIFY RETRACT GRASP TIGHTEN TIGHTEN PLACE GRASP
CLOSE RELEASE STOW STOW ABORT"""


def test_kind_order_and_number_are_those_of_the_scenario():
    assert [line.label for line in LINES] == [f"C{n}" for n in range(1, 41)]
    assert [line.text.split()[0] for line in LINES] == VERBS.split()
    for line in LINES:
        record(line.text)  # parses


@pytest.mark.parametrize("pair", ["C3 C4", "C5 C6", "C8 C9", "C21 C22", "C22 C23", "C38 C39"])
def test_lines_about_different_things_are_given_at_once(pair):
    first, second = pair.split()
    waiting, seen = {second}, set()
    while waiting:
        seen |= (label := {waiting.pop()})
        waiting |= set().union(*(NEEDED[one] for one in label)) - seen - swapout.LASTING.keys()
    assert first not in seen


@pytest.mark.parametrize(
    ("line", "before"), [("C7", "C5"), ("C19", "C18"), ("C20", "C17"), ("C25", "C21"), ("C33", "C32")]
)
def test_a_line_waits_for_the_last_one_about_the_same_thing(line, before):
    assert before in NEEDED[line]


def test_what_was_in_execution_at_once_is_counted():
    course = lines.Course(executing={"C1": [0.0, 2.0], "C2": [1.0, 3.0], "C3": [2.0, 4.0]})
    assert course.together(["C1", "C2", "C3"]) == 2
    assert course.together(["C1", "C3"]) == 1


@pytest.mark.parametrize(
    ("label", "kind", "wanted"),
    [
        ("C3", OutcomeKind.SUCCEEDED, True),
        ("C3", OutcomeKind.REFUSED, False),
        ("C1", OutcomeKind.REFUSED, True),
        ("C1", OutcomeKind.SUCCEEDED, False),
        ("C2", OutcomeKind.REFUSED, False),
        ("C8", OutcomeKind.ABORTED, True),
        ("C8", OutcomeKind.SUCCEEDED, False),
    ],
)
def test_only_the_test_of_the_left_arm_is_refused_and_only_a_lasting_line_aborted(label, kind, wanted):
    assert swapout.as_wanted(label, kind) is wanted
