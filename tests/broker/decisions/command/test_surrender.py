"""Surrender to the operator: what waits for a failed command, or for its arm, is held until it is done (R81)."""

from __future__ import annotations

import msgspec
import pytest

from rtc.protocol.advice import by_person, by_sentence
from rtc.protocol.messages import Assessment
from rtc.protocol.outcomes import OutcomeKind, StopReason
from rtc.protocol.primitive import TeleopMotion
from tests.broker.harness import Harness, bound, give_up, go_on, script
from tests.simulation.invariants import violations

ASKED = "GRASP MODULE WITH RIGHT-ARM VIA OPERATOR-INTERVENTION"


def ultimate() -> Assessment:
    return msgspec.structs.replace(give_up(), clears=by_person("look what is in the way"), by_operator=ASKED)


def surrendered() -> Harness:
    """C-1 has failed; C-2 comes after it, C-3 waits for its arm, and C-4 uses the other one."""
    s = Harness()
    s.analyzing()
    s.parsed(after="C-1", hand="LEFT-ARM")
    s.parsed()
    s.executing(script(resources=("LEFT-ARM",)), hand="LEFT-ARM")
    s.answers("C-1", ultimate())
    assert not violations(s.state)
    return s


def by_operator(s: Harness, reason: StopReason) -> str:
    command = s.elaborated()
    made = bound(f"{command}.1")
    assert made.primitive is not None
    operated = msgspec.structs.replace(
        made.primitive, trajectory=TeleopMotion(request="move it", speed_m_s=0.1, turn_rad_s=0.5)
    )
    s.answers(command, msgspec.structs.replace(made, primitive=operated))
    s.reports(command, reason)
    s.answers(command, go_on(reason) if reason is StopReason.OPERATOR_DONE else give_up(reason))
    assert s.phase(command) == "gone"
    return command


def test_the_outcome_names_the_sentence_for_the_operator_and_what_waits_is_held():
    s = surrendered()
    refusal = s.outcome("C-1").refusal
    assert refusal.by_operator == ASKED
    assert refusal.clears == [*by_person("look what is in the way"), *by_sentence(ASKED)]
    assert [s.phase(f"C-{n}") for n in (2, 3, 4)] == ["held", "held", "executing"]
    (open_,) = s.state.surrenders.values()
    assert (open_.arms, open_.sentence, sorted(open_.waiting)) == (["RIGHT-ARM"], ASKED, ["C-2", "C-3"])


def test_a_failure_that_the_operator_cannot_mend_holds_nothing():
    s = Harness()
    s.analyzing()
    s.parsed()
    s.answers("C-1", give_up())
    assert s.phase("C-2") == "elaborating"
    assert not s.state.surrenders


def test_what_waits_goes_on_when_the_operator_has_done_it():
    s = surrendered()
    s.reports("C-4")
    s.answers("C-4", go_on())
    by_operator(s, StopReason.OPERATOR_DONE)
    assert (s.phase("C-2"), s.phase("C-3")) == ("elaborating", "elaborating")
    assert not s.state.surrenders
    assert not violations(s.state)


def test_it_stays_held_when_the_operator_cannot_do_it_either():
    s = surrendered()
    by_operator(s, StopReason.OPERATOR_CANNOT)
    assert (s.phase("C-2"), s.phase("C-3")) == ("held", "held")


def test_a_later_sentence_may_use_the_arm_and_does_not_let_them_go():
    s = surrendered()
    command = s.executing()
    s.reports(command)
    s.answers(command, go_on())
    assert s.outcome(command).kind is OutcomeKind.SUCCEEDED
    assert s.phase("C-3") == "held"


@pytest.mark.parametrize(
    ("sentence", "phase"), [("RESUME C-3", "elaborating"), ("ABORT C-3", "gone"), ("PAUSE C-3", "held")]
)
def test_each_can_be_let_go_or_ended(sentence: str, phase: str):
    s = surrendered()
    verb, number = sentence.split()
    s.parsed(sentence, kind="control", verb=verb, object=number)
    assert s.phase("C-3") == phase
    assert not violations(s.state)


def test_halt_all_ends_what_waits_for_the_operator():
    s = surrendered()
    s.halts()
    s.rests("h1")
    assert (s.phase("C-2"), s.phase("C-3")) == ("gone", "gone")
    assert not violations(s.state)


def test_what_is_given_after_a_surrendered_command_waits_too():
    s = surrendered()
    late = s.parsed(after="C-1")
    assert s.phase(late) == "held"
    by_operator(s, StopReason.OPERATOR_DONE)
    assert s.phase(late) in ("elaborating", "held")
    assert late not in [name for one in s.state.surrenders.values() for name in one.waiting]


def test_a_second_failure_of_the_same_arm_takes_over_what_waits():
    s = surrendered()
    second = s.analyzing()
    s.answers(second, ultimate())
    assert list(s.state.surrenders) == [second]
    assert sorted(s.state.surrenders[second].waiting) == ["C-2", "C-3"]
    assert not violations(s.state)


def test_a_surrender_without_anything_that_waits_ends_with_the_next_success_of_its_arm():
    s = Harness()
    s.analyzing()
    s.answers("C-1", ultimate())
    s.analyzing()
    s.answers("C-2", go_on())
    assert not s.state.surrenders
