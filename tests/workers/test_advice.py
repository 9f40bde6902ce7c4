"""The reader of advice that campaigns follow: it judges the program, so it must read what a person would read."""

from __future__ import annotations

import itertools

import pytest

from sim_mcm.arms.kinematic_arm import KinematicCell
from tests.campaigns import advice
from tests.campaigns.advice import Answer
from tests.workers.conftest import CELL
from tests.workers.eyes import Ideal
from tests.workers.one_process import OneProcess

TRUTH = {
    "poses": {"MACS-NEW": [0.8, -0.8, 0.6, 0.0, 0.0, 0.0, 1.0]},
    "seats": {},
    "turns": {"BOLT-1": (0.0, 8.0), "BOLT-2": (8.0, 8.0)},
}


def read(text: str) -> list[list[str]]:
    return advice.steps(text, "STOW RIGHT-ARM", lambda: TRUTH)


@pytest.mark.parametrize(
    ("text", "steps"),
    [
        ("LOCATE MACS-NEW; try again", [["LOCATE MACS-NEW"], ["STOW RIGHT-ARM"]]),
        ("look what is in the way, then RETRACT RIGHT-ARM", [["RETRACT RIGHT-ARM"]]),
        (
            "LOCATE MACS-NEW, or state where it is: SET MACS-NEW FRAME x y z CM roll pitch yaw DEG",
            [["LOCATE MACS-NEW", "SET MACS-NEW FRAME 80.00 -80.00 60.00 CM 0.00 0.00 0.00 DEG"]],
        ),
        ("move LEFT-ARM away first", [["STOW LEFT-ARM"]]),
        (
            "another goal; or MOVE RIGHT-ARM TO another place first (CLEAR-POINT-1)",
            [["MOVE RIGHT-ARM TO CLEAR-POINT-1"]],
        ),
        ("PLACE MACS-NEW ON RACK-1 or BAY-2, or another arm", [["PLACE MACS-NEW ON RACK-1"]]),
        ("another goal: RACK-1 is there", []),
        ("look and state it: SET BOLT-1 STATE LOOSE or TIGHT", [["SET BOLT-1 STATE TIGHT"]]),
        ("look and state it: SET BOLT-2 STATE LOOSE or TIGHT", [["SET BOLT-2 STATE LOOSE"]]),
    ],
)
def test_the_sentences_of_an_advice_are_its_steps_and_their_alternatives(text: str, steps: list[list[str]]) -> None:
    assert read(text) == steps


class Obstacles:
    """A sentence that succeeds after the cures of some obstacles."""

    def __init__(self, *cures: str) -> None:
        self.cures = list(cures)
        self.given: list[str] = []

    def say(self, sentence: str) -> Answer:
        self.given.append(sentence)
        if sentence == "STOW RIGHT-ARM":
            return self.answer()
        if self.cures and sentence == self.cures[0]:
            self.cures.pop(0)
        return Answer(True, "", "")

    def answer(self) -> Answer:
        return Answer(False, "blocked", self.cures[0]) if self.cures else Answer(True, "", "")


def follow(scene: Obstacles) -> str:
    return advice.follow(scene.say, "STOW RIGHT-ARM", scene.answer(), lambda: TRUTH).end


def test_advice_that_clears_one_obstacle_after_the_other_reaches_the_aim() -> None:
    scene = Obstacles("RETRACT LEFT-ARM", "LOCATE MACS-NEW")
    assert follow(scene) == "reached"
    assert scene.given == ["RETRACT LEFT-ARM", "STOW RIGHT-ARM", "LOCATE MACS-NEW", "STOW RIGHT-ARM"]


def test_the_same_advice_twice_does_not_lead_out() -> None:
    scene = Obstacles("RETRACT LEFT-ARM")
    scene.say = lambda sentence: scene.answer() if sentence == "STOW RIGHT-ARM" else Answer(True, "", "")
    assert follow(scene) == "same advice"


def test_two_advices_in_turn_do_not_lead_out() -> None:
    scene = Obstacles()
    turns = itertools.cycle(["LOCATE MACS-NEW", "RETRACT LEFT-ARM"])
    scene.answer = lambda: Answer(False, "blocked", next(turns))
    assert follow(scene) == "same advice"


def test_advice_without_a_sentence_is_a_case_of_its_own() -> None:
    scene = Obstacles("another goal: RACK-1 is there")
    assert follow(scene) == "no sentence"
    assert scene.given == []


def test_a_smaller_distance_from_neighbours_is_put_into_the_sentence() -> None:
    given = []

    def say(sentence: str) -> Answer:
        given.append(sentence)
        return Answer(True, "", "")

    aim = "STOW RIGHT-ARM MAINTAIN AVOID-NEIGHBORS BY 1.5 CM AND SPEED 10 CM/S"
    refused = Answer(False, "near", "AVOID-NEIGHBORS BY 14 MM, or leave it out; or another goal")
    assert advice.follow(say, aim, refused, lambda: TRUTH).end == "reached"
    assert given == ["STOW RIGHT-ARM MAINTAIN AVOID-NEIGHBORS BY 14 MM AND SPEED 10 CM/S"]


@pytest.mark.parametrize(
    ("aim", "again"),
    [
        ("STOW RIGHT-ARM", "STOW RIGHT-ARM MAINTAIN AVOID-NEIGHBORS BY 4 MM"),
        ("STOW RIGHT-ARM NOW", "STOW RIGHT-ARM MAINTAIN AVOID-NEIGHBORS BY 4 MM NOW"),
        ("LIFT X MAINTAIN SPEED UNTIL CONTACT", "LIFT X MAINTAIN AVOID-NEIGHBORS BY 4 MM AND SPEED UNTIL CONTACT"),
    ],
)
def test_a_distance_that_the_sentence_does_not_state_is_put_before_its_other_clauses(aim: str, again: str) -> None:
    given = []

    def say(sentence: str) -> Answer:
        given.append(sentence)
        return Answer(True, "", "")

    refused = Answer(False, "near", "MAINTAIN AVOID-NEIGHBORS BY 4 MM, if it may come as near; or RELEASE X")
    assert advice.follow(say, aim, refused, lambda: TRUTH).end == "reached"
    assert given == [again]


def test_a_sentence_for_the_rest_takes_the_place_of_the_aim() -> None:
    given = []

    def say(sentence: str) -> Answer:
        given.append(sentence)
        return Answer(True, "", "")

    refused = Answer(False, "late", "OPEN DOOR-2 BY 12.5 DEG WITH LEFT-ARM")
    assert advice.follow(say, "OPEN DOOR-2 BY 60 DEG WITH LEFT-ARM", refused, lambda: TRUTH).end == "reached"
    assert given == ["OPEN DOOR-2 BY 12.5 DEG WITH LEFT-ARM"]


def test_the_advice_of_a_command_that_was_refused_in_a_cluster_is_followed() -> None:
    cluster = OneProcess(KinematicCell(CELL), eyes=Ideal(CELL))
    aim = "LIFT MACS-NEW BY 10 CM"  # the hand is empty
    command = cluster.give(aim)
    cluster.run()
    followed = advice.follow_in_cluster(cluster, aim, cluster.outcomes[command])
    assert (followed.end, followed.given) == ("reached", ["GRASP MACS-NEW"])
