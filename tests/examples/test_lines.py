"""The lines of the swap-out: what they are, and which of them a planner gives at once."""

from __future__ import annotations

import io
from types import SimpleNamespace

import pytest
from rich.console import Console

from examples.swapout import lines, swapout
from rtc.apps.demos.narrator import Narrator
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Outcome, OutcomeKind
from rtc.protocol.rehearsal import Rehearsal, RehearsedStep
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


def test_a_line_that_is_left_out_stands_for_those_it_waits_for():
    needed = {"C1": set(), "C2": {"C1"}, "C3": {"C2"}, "C4": {"C2", "C3"}, "C5": set()}
    assert lines.among(["C1", "C4", "C5"], needed) == {"C1": set(), "C4": {"C1"}, "C5": set()}
    assert lines.among(list(needed), needed) == needed


@pytest.mark.parametrize("name", swapout.PARTS)
def test_a_part_has_lines_of_the_task_that_end_it_and_no_line_waits_for_itself(name):
    part = swapout.PARTS[name]
    cell = Cell.load(part.cell)
    task = [line for line in LINES if line.label not in swapout.TESTS]
    needed = lines.among(part.lines, lines.waits(task, cell, {**swapout.AFTER, **part.after}))
    assert part.event.at in part.lines
    done: list[str] = []
    while ready := [label for label in part.lines if label not in done and needed[label] <= set(done)]:
        done += ready
    assert sorted(done) == sorted(part.lines)
    for labels in part.at_once:
        first, second = labels.split()
        assert first not in needed[second]
        assert second not in needed[first]


def test_the_door_is_closed_when_both_arms_have_left_the_bay():
    part = swapout.PARTS["insertion"]
    task = [line for line in LINES if line.label not in swapout.TESTS]
    needed = lines.among(part.lines, lines.waits(task, CELL, {**swapout.AFTER, **part.after}))
    assert needed["C36"] >= {"C35", "C39"}
    assert "C30" in needed["C39"]


def test_the_time_line_shows_the_number_of_a_line_where_there_is_room():
    row = swapout.track({"C1": [0.0, 4.0], "C22": [5.0, 5.5], "C3": [6.0, 89.0]}, 1.0)
    assert row[:10] == "1----'3---"
    assert len(row) == swapout.COLUMNS


def test_a_caption_shows_what_each_arm_is_commanded_to_do_until_it_is_done():
    captions = swapout.Captions(CELL)
    of = {line.label: line for line in LINES}
    assert captions.begins(of["C7"]) == "LEFT-ARM  C7 OPEN DOOR-2 BY 90 DEG\nRIGHT-ARM   "
    assert captions.begins(of["C22"]).splitlines()[1] == "RIGHT-ARM  C22 GRASP MACS-NEW HANDLE-A"
    assert captions.ends(of["C7"]).splitlines()[0] == "LEFT-ARM   "
    both = captions.begins(of["C25"]).splitlines()
    assert {line.partition("  ")[2] for line in both} == {"C25 CARRY MACS-NEW TO BAY-2-FRONT"}


def test_on_paper_each_line_has_the_number_by_which_others_name_it():
    given: dict[str, str] = {}

    def test(texts, labels, keep_going):
        given.update(zip(labels, texts, strict=True))
        return [SimpleNamespace(outcome=Outcome(kind=OutcomeKind.SUCCEEDED, rehearsal=Rehearsal())) for _ in texts]

    rtc = SimpleNamespace(
        test=test,
        truth=lambda: SimpleNamespace(joints={}, poses={}),
        world=SimpleNamespace(view=lambda: SimpleNamespace(version=1, facts=[])),
    )
    assert swapout.on_paper(Narrator(Console(file=io.StringIO())), rtc, LINES).keys() == {line.label for line in LINES}
    named = {found[0] for text in given.values() for found in lines.COMMAND.finditer(text)}
    assert named == {"C-8", "C-23"}
    assert named <= given.keys()


def test_durations_are_compared_for_steps_that_end_at_their_goal_as_first_performed():
    def step(label: str, reason: str, predicted_s: float) -> RehearsedStep:
        return RehearsedStep(label=label, reason=reason, predicted_s=predicted_s)

    ahead = [
        step("go", "goal", 2.0),
        step("feel", "contact", 1.0),
        step("close", "goal", 1.0),
        step("up", "goal", 0.5),
    ]
    took = [("go", 2.05), ("feel", 3.0), ("close", 1.2), ("close", 5.0)]  # closed again by a trim; never up
    known = swapout.at_goals(ahead, took)
    assert [(one.label, one.measured_s, one.off) for one in known] == [("go", 2.05, False), ("close", 1.2, True)]


def test_what_was_in_execution_at_once_is_counted():
    course = lines.Course(executing={"C1": [0.0, 2.0], "C2": [1.0, 3.0], "C3": [2.0, 4.0]})
    assert course.together(["C1", "C2", "C3"]) == 2
    assert course.together(["C1", "C3"]) == 1


def test_an_end_that_comes_late_from_a_busy_machine_lasts_no_longer():
    """A line that another one has aborted was counted as in execution beside the next line of its arm."""
    course = lines.Course(begun_s=100.0)
    for label, at_s in (("C8", 101.0), ("C19", 103.5)):
        course.note(label, m.ProgressNote(seq=1, at_s=at_s, command="C-1", phase=m.Phase.EXECUTING))
    ended = Outcome(kind=OutcomeKind.ABORTED)
    course.end("C8", m.CommandEnded(seq=2, at_s=103.0, command="C-1", request="", text="", outcome=ended, took_s=2.0))
    assert course.executing["C8"] == [1.0, 3.0]
    assert course.together(["C8", "C19"]) == 1


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
    assert (kind in swapout.WHOLE.wanted(label)) is wanted
