"""Advice is offered without the sentences that would be refused themselves."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pytest

from rtc.protocol.advice import ANOTHER_ARM, Advice, Alternative, by_person, by_sentence, sentences_of
from rtc.protocol.messages import Script, Validity
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.sentence import ParsedCommand
from tests.workers.conftest import Bench
from workers.elaborator.tested_advice import AdviceTest, without_infeasible
from workers.planning import trust
from workers.planning.world_query import WorldQuery


class Unforeseen:
    """The refusals of a world after which no other one is known."""

    def __init__(self, why: Callable[[ParsedCommand], Refusal | None]) -> None:
        self._why = why

    def __call__(self, parsed: ParsedCommand) -> Refusal | None:
        return self._why(parsed)

    def after(self, parsed: ParsedCommand) -> None:
        return None

    def stated(self, keys: Iterable[str]) -> None:
        return None


def advised(clears: Advice, *not_feasible: str, in_the_way: str = "") -> Advice:
    refusal = Refusal(reason=RefusalReason.INFEASIBLE, message="blocked", clears=clears, in_the_way=in_the_way)

    def why(parsed: ParsedCommand) -> Refusal | None:
        place = parsed.place.name if parsed.place else None
        refused = f"{parsed.verb} {place or parsed.object or parsed.hand}" in not_feasible
        return Refusal(reason=RefusalReason.INFEASIBLE, message="no way") if refused else None

    return without_infeasible(refusal, AdviceTest(Unforeseen(why))).clears


RETRACT, CLEAR = by_sentence("RETRACT RIGHT-ARM"), by_sentence("MOVE RIGHT-ARM TO CLEAR-POINT-1")
BAY = by_sentence("MOVE RIGHT-ARM TO BAY-2-FRONT")
GOAL, WAIT = by_person("another goal"), by_person("wait")
WAY = [*RETRACT, *BAY, *CLEAR, *GOAL]
STOW = [Alternative(sentences=["STOW LEFT-ARM"], again=True)]
IN_ORDER = by_sentence("LOCATE MACS-NEW", "LIFT MACS-NEW BY 5 CM")
LET_GO = [*by_sentence("PLACE MACS-NEW ON RACK-1"), *by_sentence("RELEASE MACS-NEW VIA FREE-DRIFT")]
OPERATOR = [*GOAL, *by_sentence("GIVE RIGHT-ARM TO OPERATOR")]


@pytest.mark.parametrize(
    ("clears", "not_feasible", "left"),
    [
        (WAY, (), [*RETRACT, *BAY, *GOAL]),
        (WAY, ("RETRACT RIGHT-ARM", "MOVE BAY-2-FRONT"), [*CLEAR, *GOAL]),
        (WAY, ("RETRACT RIGHT-ARM", "MOVE BAY-2-FRONT", "MOVE CLEAR-POINT-1"), GOAL),
        ([*STOW, *WAIT], ("STOW LEFT-ARM",), WAIT),
        (IN_ORDER, ("LIFT MACS-NEW",), IN_ORDER),
        (LET_GO, ("PLACE MACS-NEW",), LET_GO),
        (OPERATOR, (), OPERATOR),
    ],
)
def test_what_has_no_way_is_left_out(clears: Advice, not_feasible: tuple[str, ...], left: Advice) -> None:
    assert advised(clears, *not_feasible) == left


def test_what_a_command_waits_for_is_not_tested() -> None:
    assert advised(STOW, "STOW LEFT-ARM", in_the_way="LEFT-ARM") == STOW


def test_a_handle_out_of_reach_is_not_advised(bench: Bench) -> None:
    """The other hand's own module is out of reach of this one."""
    refusal = bench.do("LIFT MACS-OLD BY 10 CM WITH RIGHT-ARM").refusal
    assert refusal is not None
    for sentence in ("GRASP MACS-OLD WITH RIGHT-ARM", "GRASP MACS-OLD HANDLE-B WITH RIGHT-ARM"):
        assert sentence not in sentences_of(refusal.clears)


def test_a_look_is_not_advised_after_one_that_has_missed(bench: Bench) -> None:
    bench.unsurveyed()
    bench.set_fact("MACS-NEW.frame", bench.world.value("MACS-NEW.frame"), Validity.SUSPECT)
    assert "LOCATE MACS-NEW" in sentences_of(_trusted(bench).clears)
    bench.set_fact("MACS-NEW.sighting", None)
    assert "LOCATE MACS-NEW" not in sentences_of(_trusted(bench).clears)


def _trusted(bench: Bench) -> Refusal:

    clears = {"frame": by_sentence("SET {location} FRAME"), "seen": by_sentence("LOCATE {location}")}
    refused = trust.distrusted(WorldQuery(bench.model, bench.world), "MACS-NEW.frame", clears)
    assert refused is not None
    return refused


@pytest.mark.parametrize(
    ("sentence", "other"),
    [
        ("APPROACH MACS-OLD WITH RIGHT-ARM", "APPROACH MACS-OLD WITH LEFT-ARM"),
        ("GRASP MACS-NEW WITH LEFT-ARM", "GRASP MACS-NEW WITH RIGHT-ARM"),
        ("MOVE RIGHT-ARM TO RACK-2-FRONT", "MOVE LEFT-ARM TO RACK-2-FRONT"),
        ("MOVE RIGHT-ARM TO POSITION 900 0 0 CM", ""),
        ("OPEN RIGHT-ARM BY 900 MM", ""),
    ],
)
def test_another_arm_is_named_where_it_can_do_it_and_else_not_advised(bench: Bench, sentence: str, other: str) -> None:
    """ "another arm" was advised at what no arm reaches, and at sentences that name none."""
    refusal = bench.do(sentence).refusal
    assert refusal is not None
    assert ANOTHER_ARM not in refusal.clears
    instead = [one.sentences for one in refusal.clears if one.instead]
    assert not other or instead == [[other]]
    if other:
        assert isinstance(bench.elaborate(other), Script)


def test_another_arm_is_not_advised_for_what_it_does_not_hold(bench: Bench) -> None:
    for sentence in ("GRASP MACS-NEW HANDLE-A WITH RIGHT-ARM", "LIFT MACS-NEW BY 20 CM WITH RIGHT-ARM"):
        assert bench.do(sentence).succeeded
    refusal = bench.do("PLACE MACS-NEW ON RACK-2 WITH RIGHT-ARM").refusal
    assert refusal is not None
    assert ANOTHER_ARM not in refusal.clears
    assert not any(one.instead and "LEFT-ARM" in one.sentences[0] for one in refusal.clears)


GRASP_IT = by_sentence("GRASP MACS-NEW")
VERIFY_IT = by_sentence("VERIFY MACS-NEW AT RIGHT-ARM")
STATE_IT = [Alternative(states=["MACS-NEW.frame"], words="look where it is", again=True)]
#: the refusals of sentences that are not accepted in this world, by verb: reason and advice
NOT_YET = {
    "CARRY": (RefusalReason.STATE, GRASP_IT),
    "GRASP": (RefusalReason.SUSPECT, STATE_IT),
    "PLACE": (RefusalReason.SUSPECT, VERIFY_IT),
    "MOVE": (RefusalReason.INFEASIBLE, by_sentence("RETRACT RIGHT-ARM")),
    "ALIGN": (RefusalReason.STATE, by_sentence("ALIGN MACS-NEW TO RACK-1")),
}


@pytest.mark.parametrize(
    ("sentence", "refused", "before", "states"),
    [
        ("PLACE MACS-NEW ON RACK-1", "PLACE", ["VERIFY MACS-NEW AT RIGHT-ARM"], []),
        ("CARRY MACS-NEW TO CLEAR-POINT-1", "CARRY", ["GRASP MACS-NEW"], []),
        ("CARRY MACS-NEW TO CLEAR-POINT-1", "CARRY GRASP", ["GRASP MACS-NEW"], ["MACS-NEW.frame"]),
        ("MOVE RIGHT-ARM TO BAY-2-FRONT", "MOVE", None, []),  # no other sentence makes a way
        ("ALIGN MACS-NEW TO RACK-1", "ALIGN", None, []),  # its advice is itself
        ("STOW RIGHT-ARM", "", None, []),  # needs nothing before it
    ],
)
def test_what_comes_before_a_sentence_that_is_not_accepted_yet(
    sentence: str, refused: str, before: list[str] | None, states: list[str]
) -> None:
    def why(parsed: ParsedCommand) -> Refusal | None:
        if parsed.verb not in refused.split():
            return None
        reason, clears = NOT_YET[parsed.verb]
        return Refusal(reason=reason, message="not yet", clears=clears)

    advice = AdviceTest(Unforeseen(why)).after_another([sentence])
    if before is None:
        assert advice == []
    else:
        (one,) = advice
        assert one.sentences == [*before, sentence]
        assert one.states == states
        assert one.instead
        assert not one.again


@pytest.mark.parametrize("sentence", ["MOVE RIGHT-ARM TO RACK-2-FRONT", "GRASP MACS-OLD WITH RIGHT-ARM"])
def test_the_operator_is_not_asked_for_what_the_arm_does_not_reach(bench: Bench, sentence: str) -> None:
    refusal = bench.do(sentence).refusal
    assert refusal is not None
    assert not any("VIA" in one for one in sentences_of(refusal.clears))
    assert refusal.by_operator == ""
    asked = bench.do(f"{sentence} VIA OPERATOR-INTERVENTION").refusal
    assert asked is not None
    assert asked.reason is RefusalReason.INFEASIBLE


def test_another_arm_is_advised_by_its_sentence_for_the_operator_too(bench: Bench) -> None:
    refusal = bench.do("MOVE RIGHT-ARM TO RACK-2-FRONT VIA OPERATOR-INTERVENTION").refusal
    assert refusal is not None
    assert refusal.clears[0].sentences == ["MOVE LEFT-ARM TO RACK-2-FRONT VIA OPERATOR-INTERVENTION"]
    assert not isinstance(bench.elaborate(refusal.clears[0].sentences[0]), Refusal)
