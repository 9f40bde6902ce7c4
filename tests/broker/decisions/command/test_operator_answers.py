"""DONE, CANNOT and TAKE: passed on, and settled by what becomes of the primitive that they are about."""

from __future__ import annotations

import msgspec
import pytest

from broker.decisions import events
from rtc.protocol.outcomes import OutcomeKind, StopReason
from rtc.protocol.primitive import TeleopMotion
from rtc.wording.advice import in_one_line
from tests.broker.harness import Harness, bound, record, script

BY_HAND = TeleopMotion(request="move it", speed_m_s=0.1, turn_rad_s=0.5)


def by_hand(s: Harness, arm: str = "RIGHT-ARM", verb: str = "GRASP") -> str:
    """A command whose primitive the operator performs."""
    command = s.elaborated(script(resources=(arm,)), verb=verb, hand=arm)
    made = bound(f"{command}.1", arm)
    assert made.primitive is not None
    primitive = msgspec.structs.replace(made.primitive, trajectory=BY_HAND)
    s.answers(command, msgspec.structs.replace(made, primitive=primitive))
    return command


def answer(s: Harness, verb: str, **fields) -> tuple[str, str]:
    """The command of an answer, and what of it has left."""
    s.says(f"{verb} {s.state.accepted}")
    command = f"C-{s.state.accepted}"
    sent = s.answers(command, record("operator", verb, **fields))
    return command, " ".join(line for line in sent if line.startswith(("done", "cannot")))


def test_done_waits_for_the_report_that_proves_it() -> None:
    s = Harness()
    asked = by_hand(s)
    done, sent = answer(s, "DONE")
    assert sent == f"done {asked}.1 to MCM"
    assert s.phase(done) == "held"
    s.reports(asked, StopReason.OPERATOR_DONE)
    assert s.outcome(done).kind is OutcomeKind.SUCCEEDED
    assert s.phase(asked) == "analyzing"


def test_a_done_that_is_not_proved_is_refused_and_may_come_again() -> None:
    s = Harness()
    asked = by_hand(s)
    first, _ = answer(s, "DONE")
    s.handle(events.AnswerWasRefused, primitive=f"{asked}.1", message="it is 310 mm away")
    assert s.outcome(first).kind is OutcomeKind.REFUSED
    assert "310 mm" in s.outcome(first).message  # wording: of the subsystem, for the operator
    assert s.phase(asked) == "executing"
    second, _ = answer(s, "DONE")
    s.reports(asked, StopReason.OPERATOR_DONE)
    assert s.outcome(second).kind is OutcomeKind.SUCCEEDED


@pytest.mark.parametrize(("given", "sent"), [("GIVE", "done"), ("GRASP", "cannot")])
def test_take_ends_what_the_operator_does_with_that_arm(given: str, sent: str) -> None:
    s = Harness()
    asked = by_hand(s, verb=given)
    refused, nothing = answer(s, "TAKE", hand="LEFT-ARM")
    assert (s.outcome(refused).kind, nothing) == (OutcomeKind.REFUSED, "")
    assert answer(s, "TAKE", hand="RIGHT-ARM")[1] == f"{sent} {asked}.1 to MCM"


def test_a_take_before_the_arm_is_handed_over_names_the_give_that_will() -> None:
    s = Harness()
    holding = by_hand(s)  # it has the arm, so that the GIVE waits
    s.says("GIVE RIGHT-ARM TO OPERATOR")
    waiting = f"C-{s.state.accepted}"
    s.answers(waiting, record("task", "GIVE", hand="RIGHT-ARM"))
    s.reports(holding, StopReason.OPERATOR_DONE)
    refused, sent = answer(s, "TAKE", hand="RIGHT-ARM")
    assert (s.outcome(refused).kind, sent) == (OutcomeKind.REFUSED, "")
    why = s.outcome(refused).refusal
    assert [one.sentences for one in why.clears] == [[f"ABORT {waiting}"], []]
    assert why.clears[1].again


def test_no_duration_is_foretold_of_what_a_person_does() -> None:
    s = Harness()
    asked = by_hand(s)
    assert s.state.commands[asked].notes[-1].expected_s == 0.0


def test_an_answer_without_a_request_is_refused_and_one_of_two_too() -> None:
    s = Harness()
    none, _ = answer(s, "DONE")
    assert s.outcome(none).kind is OutcomeKind.REFUSED
    by_hand(s, "LEFT-ARM")
    by_hand(s, "RIGHT-ARM")
    of_two, _ = answer(s, "CANNOT", reason="no")
    assert s.outcome(of_two).kind is OutcomeKind.REFUSED
    assert "TAKE" in in_one_line(s.outcome(of_two).refusal.clears)


@pytest.mark.parametrize("how", ["force", "halt", "lost"])
def test_an_answer_never_waits_for_what_has_ended_otherwise(how: str) -> None:
    s = Harness()
    asked = by_hand(s)
    done, _ = answer(s, "DONE")
    if how == "force":
        s.reports(asked, StopReason.FORCE_LIMIT)
    elif how == "halt":
        s.halts(asked)
        s.reports(asked, StopReason.HALT)
    else:
        s.mcm_gone()
        s.answers(asked, {"verdict": "abort", "reason": "subsystem_lost"})
    assert s.outcome(done).kind is OutcomeKind.REFUSED
    assert not s.state.answers


def test_an_answer_is_sent_again_when_its_subsystem_connects_again() -> None:
    s = Harness()
    asked = by_hand(s)
    answer(s, "CANNOT", reason="it is stuck")
    assert f"cannot {asked}.1 to MCM" in s.mcm_hello(outstanding=[f"{asked}.1"])


def test_an_answer_can_be_aborted() -> None:
    s = Harness()
    asked = by_hand(s)
    done, _ = answer(s, "DONE")
    s.says(f"ABORT {done}")
    s.answers(f"C-{s.state.accepted}", {"type": "ParsedCommand", "kind": "control", "verb": "ABORT", "object": done})
    assert s.outcome(done).kind is OutcomeKind.ABORTED
    s.reports(asked, StopReason.OPERATOR_DONE)
    assert not s.state.answers
