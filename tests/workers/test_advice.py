"""The reader of advice that campaigns follow: it judges the program, so it must read what a person would read."""

from __future__ import annotations

import itertools

import pytest

from rtc.protocol.advice import Alternative, by_person, by_sentence
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


def looked(fact: str) -> Alternative:
    return Alternative(states=[fact], words="look where it is, and state it")


@pytest.mark.parametrize(
    ("one", "sentences"),
    [
        (Alternative(sentences=["RETRACT RIGHT-ARM"], words="look what is in the way"), ["RETRACT RIGHT-ARM"]),
        (looked("MACS-NEW.frame"), ["SET MACS-NEW FRAME 80.00 -80.00 60.00 CM 0.00 0.00 0.00 DEG"]),
        (looked("BOLT-1.state"), ["SET BOLT-1 STATE TIGHT"]),
        (looked("BOLT-2.state"), ["SET BOLT-2 STATE LOOSE"]),
        (
            Alternative(
                sentences=["SET MACS-NEW FRAME 1 2 3 CM 0 0 0 DEG", "STOW LEFT-ARM"], states=["MACS-NEW.frame"]
            ),
            ["SET MACS-NEW FRAME 80.00 -80.00 60.00 CM 0.00 0.00 0.00 DEG", "STOW LEFT-ARM"],
        ),
        (Alternative(words="another goal: RACK-1 is there"), []),
        (Alternative(sentences=["STOW LEFT-ARM VIA OPERATOR-INTERVENTION"]), []),
        (Alternative(sentences=["ABORT C-3"]), []),
    ],
)
def test_the_sentences_of_an_alternative_are_those_of_a_person_who_looks(
    one: Alternative, sentences: list[str]
) -> None:
    assert advice.sentences(one, lambda: TRUTH) == sentences


def test_the_first_alternative_with_a_sentence_is_followed_by_the_same_again() -> None:
    options = [Alternative(words="wait"), Alternative(sentences=["LOCATE MACS-NEW"], again=True)]
    assert advice.first(options, "STOW RIGHT-ARM", lambda: TRUTH) == ["LOCATE MACS-NEW", "STOW RIGHT-ARM"]


def blocked(sentence: str) -> Answer:
    return Answer(False, "blocked", by_sentence(sentence))


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
        return Answer(True, "")

    def answer(self) -> Answer:
        return blocked(self.cures[0]) if self.cures else Answer(True, "")


def follow(scene: Obstacles) -> str:
    return advice.follow(scene.say, "STOW RIGHT-ARM", scene.answer(), lambda: TRUTH).end


def test_advice_that_clears_one_obstacle_after_the_other_reaches_the_aim() -> None:
    scene = Obstacles("RETRACT LEFT-ARM", "LOCATE MACS-NEW")
    assert follow(scene) == "reached"
    assert scene.given == ["RETRACT LEFT-ARM", "STOW RIGHT-ARM", "LOCATE MACS-NEW", "STOW RIGHT-ARM"]


def test_the_same_advice_twice_does_not_lead_out() -> None:
    scene = Obstacles("RETRACT LEFT-ARM")
    scene.say = lambda sentence: scene.answer() if sentence == "STOW RIGHT-ARM" else Answer(True, "")
    assert follow(scene) == "same advice"


def test_two_advices_in_turn_do_not_lead_out() -> None:
    scene = Obstacles()
    turns = itertools.cycle(["LOCATE MACS-NEW", "RETRACT LEFT-ARM"])
    scene.answer = lambda: blocked(next(turns))
    assert follow(scene) == "same advice"


def test_advice_without_a_sentence_is_a_case_of_its_own() -> None:
    scene = Obstacles("RACK-1")
    scene.answer = lambda: Answer(False, "blocked", by_person("another goal: RACK-1 is there"))
    assert follow(scene) == "no sentence"
    assert scene.given == []


def test_a_smaller_distance_from_neighbours_is_kept_from_then_on() -> None:
    given = []

    def say(sentence: str) -> Answer:
        given.append(sentence)
        return Answer(len(given) > 1, "near", by_sentence("STOW LEFT-ARM"))

    aim = "STOW RIGHT-ARM MAINTAIN AVOID-NEIGHBORS BY 1.5 CM AND SPEED 10 CM/S"
    closer = "STOW RIGHT-ARM MAINTAIN SPEED 10 CM/S AND AVOID-NEIGHBORS BY 14 MM"
    refused = Answer(False, "near", by_sentence(closer, instead=True))
    assert advice.follow(say, aim, refused, lambda: TRUTH).end == "reached"
    assert given == [closer, "STOW LEFT-ARM", closer]


def test_after_what_is_done_instead_the_aim_is_not_given() -> None:
    given = []

    def say(sentence: str) -> Answer:
        given.append(sentence)
        return Answer(True, "")

    refused = Answer(False, "no way", by_sentence("STOW RIGHT-ARM", instead=True))
    assert advice.follow(say, "GRASP MACS-NEW", refused, lambda: TRUTH).end == "instead"
    assert given == ["STOW RIGHT-ARM"]


def test_a_sentence_for_the_rest_takes_the_place_of_the_aim() -> None:
    given = []

    def say(sentence: str) -> Answer:
        given.append(sentence)
        return Answer(True, "")

    refused = Answer(False, "late", by_sentence("OPEN DOOR-2 BY 12.5 DEG WITH LEFT-ARM", instead=True))
    assert advice.follow(say, "OPEN DOOR-2 BY 60 DEG WITH LEFT-ARM", refused, lambda: TRUTH).end == "reached"
    assert given == ["OPEN DOOR-2 BY 12.5 DEG WITH LEFT-ARM"]


def test_the_advice_of_a_command_that_was_refused_in_a_cluster_is_followed() -> None:
    cluster = OneProcess(KinematicCell(CELL), eyes=Ideal(CELL))
    aim = "LIFT MACS-NEW BY 10 CM"  # the hand is empty
    command = cluster.give(aim)
    cluster.run()
    followed = advice.follow_in_cluster(cluster, aim, cluster.outcomes[command])
    assert (followed.end, followed.given) == ("reached", ["GRASP MACS-NEW"])
