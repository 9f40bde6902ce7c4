"""The planner of the examples: what it does after a failure, and what its sentences may state."""

from __future__ import annotations

import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from examples.swapout import lines, swapout
from rtc.protocol.advice import by_sentence
from rtc.protocol.outcomes import Outcome, OutcomeKind, Refusal, RefusalReason
from tests.workers.conftest import record

PLANNER = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "planner_loop.py"))
OWN = [sentence for goal in PLANNER["GOALS"] for method in goal.methods for sentence in method]
SWAPOUT = [line.text for line in lines.read(swapout.LINES.read_text())]


class Robot:
    """A client whose sentences succeed, but for those that are named. A TEST finds only what is infeasible."""

    def __init__(self, infeasible: tuple[str, ...] = (), failing: dict[str, list[Outcome]] | None = None) -> None:
        self.infeasible, self.failing = infeasible, failing or {}
        self.done: list[str] = []

    def test(self, sentences: list[str]) -> list[Any]:
        kinds = [OutcomeKind.REFUSED if s in self.infeasible else OutcomeKind.SUCCEEDED for s in sentences]
        return [SimpleNamespace(outcome=Outcome(kind=kind)) for kind in kinds]

    def run(self, sentence: str) -> Any:
        self.done.append(sentence)
        ends = self.failing.get(sentence)
        return SimpleNamespace(outcome=ends.pop(0) if ends else Outcome(kind=OutcomeKind.SUCCEEDED))


def reach(robot: Robot) -> bool:
    methods = [["GRASP A", "LIFT A"], ["GRASP B", "LIFT B"]]
    reached: bool = PLANNER["reach"](robot, PLANNER["Goal"]("it is lifted", methods))
    return reached


def test_after_a_failure_the_plan_is_another_one() -> None:
    robot = Robot(failing={"LIFT A": [Outcome(kind=OutcomeKind.FAILED)]})
    assert reach(robot)
    assert robot.done == ["GRASP A", "LIFT A", "GRASP B", "LIFT B"]


def test_what_a_test_refuses_is_not_begun() -> None:
    robot = Robot(infeasible=("LIFT A",))
    assert reach(robot)
    assert robot.done == ["GRASP B", "LIFT B"]


def test_a_refusal_is_cleared_once() -> None:
    refusal = Refusal(reason=RefusalReason.STATE, message="the arm is not there", clears=by_sentence("STOW A"))
    robot = Robot(failing={"LIFT A": [Outcome(kind=OutcomeKind.REFUSED, refusal=refusal)]})
    assert reach(robot)
    assert robot.done == ["GRASP A", "LIFT A", "STOW A", "LIFT A"]


def test_without_another_method_the_goal_is_not_reached() -> None:
    failed = {sentence: [Outcome(kind=OutcomeKind.FAILED)] for sentence in ("LIFT A", "LIFT B")}
    assert not reach(Robot(failing=failed))


@pytest.mark.parametrize("sentence", [*OWN, *SWAPOUT])
def test_a_planner_names_things_and_states_no_coordinates(sentence: str) -> None:
    """R8. An amount, such as that of a lift, is none."""
    parsed = record(sentence)
    assert parsed.value is None  # of SET
    if parsed.place is not None:
        assert parsed.place.joints is None
        assert parsed.place.position is None
