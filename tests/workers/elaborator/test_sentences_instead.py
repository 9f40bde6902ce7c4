"""A refusal whose advice leads nowhere has a sentence that is accepted instead."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rtc.protocol.advice import by_sentence, sentences_of
from rtc.protocol.messages import Script, Validity, WorldChange
from rtc.wording.advice import in_one_line
from rtc.world.spread import even
from tests.campaigns import advice
from tests.campaigns.advice import Answer
from tests.campaigns.after_stops import Drawn, halt_and_follow
from tests.workers.conftest import Bench

GRASP, LIFT = "GRASP MACS-NEW {handle} WITH RIGHT-ARM", "LIFT MACS-NEW BY 20 CM WITH RIGHT-ARM"
LEVEL = " MAINTAIN POSE-DURING-MOTION LEVEL"


def lifted(bench: Bench, handle: str = "HANDLE-A") -> Bench:
    for sentence in (GRASP.format(handle=handle), LIFT):
        assert bench.do(sentence).succeeded
    return bench


def followed(bench: Bench, aim: str) -> advice.Followed:
    def truth() -> dict[str, Any]:
        return {"poses": bench.subsystem.poses, "seats": {}}

    return advice.follow(lambda text: Answer.of(bench.do(text)), aim, Answer.of(bench.do(aim)), truth)


@pytest.mark.parametrize(
    ("sentence", "instead"),
    [
        ("CARRY MACS-NEW TO RACK-2-FRONT", "CARRY MACS-NEW TO BAY-2-FRONT"),
        ("PLACE MACS-NEW ON RACK-2 WITH RIGHT-ARM", "PLACE MACS-NEW ON RACK-1 WITH RIGHT-ARM"),
        ("INSERT MACS-NEW INTO RACK-2", "INSERT MACS-NEW INTO RACK-1"),
        ("ALIGN MACS-NEW TO RACK-2", "ALIGN MACS-NEW TO RACK-1"),
        ("MOVE RIGHT-ARM BY 300 CM ALONG X", "MOVE RIGHT-ARM BY "),
        ("LIFT MACS-NEW BY 300 CM WITH RIGHT-ARM", "LIFT MACS-NEW BY "),
        ("LIFT MACS-NEW BY -60 CM WITH RIGHT-ARM", "LIFT MACS-NEW BY -"),
        ("MOVE RIGHT-ARM TO POSITION 900 0 0 CM", "STOW RIGHT-ARM"),
    ],
)
def test_what_is_advised_instead_is_accepted_and_done(bench: Bench, sentence: str, instead: str) -> None:
    """Each of these was refused with advice that had no sentence, or with one that leads back to the same refusal."""
    lifted(bench)
    refusal = bench.do(sentence).refusal
    assert refusal is not None
    assert any(one.sentences[0].startswith(instead) for one in refusal.clears if one.instead)
    assert followed(bench, sentence).end in ("instead", "reached")


def test_by_as_much_as_there_is_room_for(bench: Bench) -> None:
    lifted(bench)
    refusal = bench.do("MOVE RIGHT-ARM BY 300 CM ALONG X").refusal
    assert refusal is not None
    by_mm = float(sentences_of(refusal.clears)[0].split()[3])
    assert 0.0 < by_mm < 1e3 * float(refusal.along_m)


def test_a_level_way_that_none_is_found_for_is_offered_without_that(bench: Bench) -> None:
    lifted(bench)
    turned = bench.do("MOVE RIGHT-ARM TO JOINTS 0 110 -160 0 0 0 DEG")
    assert turned.succeeded, turned.refusal
    refusal = bench.do("CARRY MACS-NEW TO RACK-1-FRONT" + LEVEL).refusal
    assert refusal is not None
    assert "off LEVEL" in refusal.message
    assert by_sentence("CARRY MACS-NEW TO RACK-1-FRONT", instead=True)[0] in refusal.clears


def test_a_straight_way_that_is_blocked_is_offered_without_that() -> None:
    """RETRACT was advised, and then again."""
    later = f"MOVE RIGHT-ARM TO CLEAR-POINT-1 STRAIGHT-LINE{LEVEL}"
    drawn = Drawn("lifted", "RIGHT-ARM", "INSERT MACS-NEW INTO BAY-2 WITH RIGHT-ARM", 1, 0.0857, later)
    ran = halt_and_follow(drawn, np.random.default_rng(5))
    assert ran is not None
    assert ran.end in ("instead", "done"), ran.story


def test_a_task_that_is_advised_already_gets_no_other(bench: Bench) -> None:
    refusal = bench.do(LIFT).refusal
    assert refusal is not None
    assert not any(one.instead for one in refusal.clears)  # GRASP it first


def test_a_doubtful_grasp_is_checked_before_a_second_hand_takes_it(bench: Bench) -> None:
    """The advised GRASP was refused itself, and then advised again."""
    lifted(bench)
    bench.set_fact("MACS-NEW.grasp", bench.world.value("MACS-NEW.grasp"), Validity.SUSPECT)
    bench.set_fact("MACS-NEW.frame", bench.world.value("MACS-NEW.frame"), Validity.SUSPECT)
    refusal = bench.do("MOVE BOTH-ARMS BY 5 CM ALONG UP").refusal
    assert refusal is not None
    first = ["VERIFY MACS-NEW AT RIGHT-ARM", "GRASP MACS-NEW HANDLE-B WITH LEFT-ARM"]
    assert refusal.clears[0].sentences == first


def test_a_check_by_the_fingers_is_not_advised_where_the_pose_stays_too_uncertain(bench: Bench) -> None:
    """VERIFY clears the doubt, and ALIGN is refused as before: the pose in the hand is known within 30 mm."""
    bench.without_cameras()
    lifted(bench)
    spread = even(0.03, 0.2)
    doubt = [WorldChange(key="MACS-NEW.grasp", keep_value=True, validity=Validity.SUSPECT, spread=spread)]
    bench.world = bench.world.overlay(doubt)
    refusal = bench.do("ALIGN MACS-NEW TO BAY-2").refusal
    assert refusal is not None
    assert "VERIFY" not in in_one_line(refusal.clears)
    assert "SET MACS-NEW FRAME" in in_one_line(refusal.clears)
    end = followed(bench, "ALIGN MACS-NEW TO BAY-2").end
    assert end == "reached"


def test_before_a_handoff_it_is_lifted_again_by_its_other_handle(bench: Bench) -> None:
    """The advice went round between HANDOFF, which needs it out of its seat, and PLACE."""
    lifted(bench, "HANDLE-B")
    aim = "HANDOFF MACS-NEW FROM RIGHT-ARM TO LEFT-ARM"
    refusal = bench.do(aim).refusal
    assert refusal is not None
    done = followed(bench, aim)
    assert done.end == "reached", done.history
    assert len(done.given) <= advice.MAX_SENTENCES


def test_what_two_hands_hold_is_let_go_of_by_one_before_the_other_moves_alone(bench: Bench) -> None:
    lifted(bench)
    assert bench.do("CARRY MACS-NEW TO BAY-2-FRONT WITH BOTH-ARMS").succeeded
    assert followed(bench, "MOVE RIGHT-ARM TO RACK-1-FRONT").end in ("reached", "instead")


@pytest.mark.parametrize("sentence", ["LOCATE MACS-NEW", "VERIFY MACS-NEW AT RACK-1"])
def test_what_no_camera_sees_is_stated_instead(bench: Bench, sentence: str) -> None:
    bench.without_cameras()
    assert followed(bench, sentence).end == "instead"


@pytest.mark.parametrize(
    ("sentence", "instead"),
    [
        ("OPEN DOOR-2 BY 300 DEG", "OPEN DOOR-2 TO 99 DEG"),
        ("CLOSE DOOR-2 BY 100 DEG", "CLOSE DOOR-2"),
        ("LOCATE BOLT-1", "LOCATE SATELLITE"),
    ],
)
def test_a_door_is_turned_as_far_as_it_goes_and_a_bolt_found_by_what_it_is_on(sentence: str, instead: str) -> None:
    drawn = Drawn("open door", "LEFT-ARM", "OPEN DOOR-2 BY 20 DEG WITH LEFT-ARM", 1, 0.5, sentence)
    ran = halt_and_follow(drawn, np.random.default_rng(3))
    assert ran is not None
    assert ran.end in ("done", "instead"), ran.story
    assert any(f"{instead} instead" in line for line in ran.story)


def test_the_last_resort_is_data_of_the_program(bench: Bench) -> None:
    bench.load("elaborator", "frees: ['RETRACT {arm}']")
    refusal = bench.do("MOVE RIGHT-ARM TO POSITION 900 0 0 CM").refusal
    assert refusal is not None
    assert (refusal.clears[-1].sentences, refusal.clears[-1].instead) == (["RETRACT RIGHT-ARM"], True)
    assert isinstance(bench.elaborate("RETRACT RIGHT-ARM"), Script)
