"""A refusal whose advice leads nowhere has a sentence that is accepted instead."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rtc.protocol import causes
from rtc.protocol.advice import by_sentence, sentences_of
from rtc.protocol.messages import Script, Validity, WorldChange
from rtc.protocol.outcomes import StopReason
from rtc.wording.advice import in_one_line
from rtc.world.spread import even
from tests.campaigns import advice
from tests.campaigns.advice import Answer
from tests.campaigns.after_stops import Drawn, halt_and_follow
from tests.workers.conftest import Bench
from workers.planning import trust
from workers.planning.world_query import WorldQuery

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
    assert isinstance(refusal.cause, causes.OffAttitude)
    assert refusal.cause.attitude == "LEVEL"
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
    assert not refusal.clears[-1].words  # the hand is empty, and nothing holds the arm: there is nothing to free


def test_a_hand_is_named_once(bench: Bench) -> None:
    refusal = bench.do("VERIFY MACS-NEW AT RIGHT-ARM").refusal
    assert refusal is not None
    assert sentences_of(refusal.clears) == ["GRASP MACS-NEW WITH RIGHT-ARM"]


def later(drawn: Drawn, seed: int = 5) -> Any:
    ran = halt_and_follow(drawn, np.random.default_rng(seed))
    assert ran is not None
    return ran


#: stops after which a hand holds nothing, or what it holds is in doubt; then a sentence that no script takes as it is
NOT_HELD = ("seated", "RELEASE MACS-NEW WITH RIGHT-ARM", StopReason.HALT)
TOUCHED = ("seated", "RELEASE MACS-NEW WITH RIGHT-ARM", StopReason.CONTACT)
IN_DOUBT = ("lifted", "STOW RIGHT-ARM", StopReason.HALT)


@pytest.mark.parametrize("cameras", [True, False])
@pytest.mark.parametrize(
    ("stopped", "place"),
    [
        *((stopped, "CLEAR-POINT-1") for stopped in (NOT_HELD, TOUCHED, IN_DOUBT)),
        *((stopped, "RACK-2-FRONT") for stopped in (NOT_HELD, IN_DOUBT)),  # out of the reach of this arm
    ],
)
def test_a_form_that_no_script_takes_leads_to_one_that_is_done(
    stopped: tuple[str, str, StopReason], cameras: bool, place: str
) -> None:
    """The advice named no sentence: the other form was refused for a doubt, or for what a GRASP establishes."""
    start, sentence, stop = stopped
    aim = f"CARRY MACS-NEW TO {place} STRAIGHT-LINE"
    ran = later(Drawn(start, "RIGHT-ARM", sentence, 1, 0.4, aim, stop, cameras))
    assert ran.end in ("instead", "done"), ran.story
    assert ran.given <= advice.MAX_SENTENCES


@pytest.mark.parametrize("cameras", [True, False])
@pytest.mark.parametrize("aim", ["ALIGN MACS-NEW TO RACK-1", "CARRY MACS-NEW TO RACK-2-FRONT STRAIGHT-LINE"])
def test_what_no_measurement_clears_comes_before_a_doubt(aim: str, cameras: bool) -> None:
    """VERIFY was advised first, then to let go with one hand, then to state the pose: five sentences and more."""
    drawn = Drawn("both", "RIGHT-ARM", "MOVE BOTH-ARMS BY 5.8 CM ALONG Y", 1, 0.4, aim, StopReason.CONTACT, cameras)
    ran = later(drawn)
    assert ran.end in ("instead", "done"), ran.story
    assert "RELEASE MACS-NEW WITH LEFT-ARM" in ran.story[1]


def test_a_door_in_the_hand_is_let_go_of_before_it_is_felt(bench: Bench) -> None:
    drawn = Drawn("door", "LEFT-ARM", "OPEN DOOR-2 BY 17 DEG WITH LEFT-ARM", 1, 0.5, "MOVE LEFT-ARM BY -10 CM ALONG X")
    ran = later(drawn)
    assert ran.end in ("instead", "done", "free"), ran.story
    assert ran.story[1].index("RELEASE DOOR-2") < ran.story[1].index("VERIFY")


@pytest.mark.parametrize(
    ("start", "sentence", "aim"),
    [
        ("lifted", "STOW RIGHT-ARM", "VERIFY MACS-NEW AT RACK-1"),
        ("lifted", "STOW RIGHT-ARM", "VERIFY MACS-NEW AT RACK-2"),
        ("seated", "RELEASE MACS-NEW WITH RIGHT-ARM", "VERIFY MACS-NEW AT BAY-2"),
    ],
)
def test_a_check_of_a_wrong_place_names_the_right_one(start: str, sentence: str, aim: str) -> None:
    """The only advice was to place it there, which is refused in the end; then the same advice came again."""
    ran = later(Drawn(start, "RIGHT-ARM", sentence, 1, 0.4, aim))
    assert ran.end in ("instead", "done"), ran.story


def test_what_a_person_has_stated_is_not_looked_for_again(bench: Bench) -> None:
    """A look knew the pose in the hand less well than the statement before it, and the two were advised in turn."""
    lifted(bench)
    assert bench.do("LOCATE MACS-NEW").succeeded
    seen = bench.world.value("MACS-NEW.sighting")["spread"]
    query = WorldQuery(bench.model, bench.world)
    assert trust.as_seen(query, "MACS-NEW.grasp")
    for share, better in ((0.5, True), (2.0, False)):
        spread = [share * one for one in seen]
        known = query.after([WorldChange(key="MACS-NEW.grasp", keep_value=True, spread=spread)])
        assert trust.as_seen(known, "MACS-NEW.grasp") is better


def test_for_both_arms_an_object_that_no_hand_holds_is_grasped_first(bench: Bench) -> None:
    refusal = bench.do("CARRY MACS-OLD TO RACK-1-FRONT WITH BOTH-ARMS").refusal
    assert refusal is not None
    assert refusal.clears[0].sentences == ["GRASP MACS-OLD"]


HALT, TOUCH, FORCE = StopReason.HALT, StopReason.CONTACT, StopReason.FORCE_LIMIT
BOTH_TO_BAY = "CARRY MACS-NEW TO BAY-2-FRONT WITH BOTH-ARMS"


@pytest.mark.parametrize(
    "drawn",
    [
        # the last advised sentence was refused: in the rack, for a doubt that the first ones leave, out of reach
        ("seated", "RELEASE MACS-NEW WITH RIGHT-ARM", 1, 0.31, "INSERT MACS-NEW INTO RACK-2", FORCE, False),
        ("both", f"MOVE BOTH-ARMS BY -10.2 CM ALONG Y{LEVEL}", 1, 0.37, "INSERT MACS-NEW INTO RACK-2", HALT, False),
        ("lifted", BOTH_TO_BAY + LEVEL, 4, 0.35, "GRASP MACS-NEW WITH LEFT-ARM", HALT, False),
        (
            "seated",
            "RELEASE MACS-NEW WITH RIGHT-ARM",
            1,
            0.5,
            "CARRY MACS-NEW TO RACK-2-FRONT STRAIGHT-LINE",
            FORCE,
            False,
        ),
        # to state the pose, which was advised again and again, makes no room
        (
            "lifted",
            "LIFT MACS-NEW BY 12.4 CM WITH RIGHT-ARM",
            1,
            0.65,
            "CARRY MACS-NEW TO CLEAR-POINT-1 WITH BOTH-ARMS",
            FORCE,
            False,
        ),
        ("seated", "EXTRACT MACS-NEW FROM RACK-1", 2, 0.92, BOTH_TO_BAY, FORCE, False),
        # what a look and a statement know was too little for one step each, and they were advised in turn
        ("lifted", "LIFT MACS-NEW BY 16.2 CM WITH RIGHT-ARM", 1, 0.91, BOTH_TO_BAY, HALT, True),
        # a look before the motion knew the pose less well than the way demands, which no sentence cleared
        ("lifted", BOTH_TO_BAY + LEVEL, 1, 0.85, "CARRY MACS-NEW TO CLEAR-POINT-1" + LEVEL, HALT, True),
        # RETRACT makes no way, and it was advised again
        (
            "lifted",
            "PLACE MACS-NEW ON RACK-1 WITH RIGHT-ARM",
            2,
            0.81,
            f"MOVE RIGHT-ARM TO CLEAR-POINT-1 STRAIGHT-LINE{LEVEL}",
            TOUCH,
            False,
        ),
        ("both", "CARRY MACS-NEW TO CLEAR-POINT-1 WITH BOTH-ARMS", 1, 0.45, "STOW RIGHT-ARM", TOUCH, False),
    ],
)
def test_no_advice_comes_again_that_was_followed(drawn: tuple[Any, ...]) -> None:
    start, *others = drawn
    ran = later(Drawn(start, "RIGHT-ARM", *others))
    assert ran.end != "stuck", ran.story


def test_the_stow_of_an_arm_beside_a_door_does_not_advise_itself() -> None:
    """The door is turned out of its way instead."""
    drawn = Drawn("open door", "LEFT-ARM", "OPEN DOOR-2 BY 20 DEG WITH LEFT-ARM", 1, 0.907, "STOW LEFT-ARM")
    ran = later(drawn)
    assert ran.end != "stuck", ran.story
    assert not any("STOW LEFT-ARM" in line.partition("[")[2] for line in ran.story if "comes within" in line)


def test_an_unknown_name_is_stated_as_it_stands_in_the_sentence(bench: Bench) -> None:
    refusal = bench.do("MOVE RIGHT-ARM TO-GRASP-POINT-OF SATELLITE").refusal
    assert refusal is not None
    assert refusal.where == "SATELLITE"


def test_a_turn_in_place_has_no_way_in_millimetres(bench: Bench) -> None:
    refusal = bench.do("MOVE RIGHT-ARM BY 180 DEG ALONG TOOL-X").refusal
    assert refusal is not None
    assert isinstance(refusal.cause, causes.JointLimitPassed)
    assert " mm" not in refusal.where
