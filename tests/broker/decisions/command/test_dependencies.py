"""AFTER and TOGETHER-WITH."""

from __future__ import annotations

import pytest

from broker.decisions.decide import CLIENTS_KEPT
from rtc.protocol.outcomes import RefusalReason
from rtc.wording.advice import in_one_line
from tests.broker.harness import Harness, bound, give_up, go_on, record

# --- after, together with -----------------------------------------------------------------------------


def test_after_waits_for_success():
    s = Harness()
    s.analyzing()
    s.says("STOW AFTER C-1")
    assert s.answers("C-2", record(after="C-1")) == ["note C-2 held"]
    assert "job C-2/2 elaborator #1" in s.answers("C-1", go_on())


def test_what_came_after_keeps_its_place_before_those_given_later():
    s = Harness()
    s.analyzing()
    s.parsed(after="C-1")
    s.parsed()
    s.answers("C-1", go_on())
    assert (s.phase("C-2"), s.phase("C-3")) == ("elaborating", "held")


def test_after_last_is_the_command_that_the_same_client_gave_before():
    s = Harness()
    s.analyzing()
    s.says("X", client="bob")
    s.says("STOW AFTER LAST", client="ann")

    assert s.answers("C-3", record(after="LAST")) == ["note C-3 held"]
    assert s.state.commands["C-3"].head.after == "C-1"
    assert "job C-3/2 elaborator #1" in s.answers("C-1", go_on())


@pytest.mark.parametrize("between", ["PAUSE", "resume C-1", "SHOW C-1", "HALT LEFT-ARM", "TEST STOW"])
def test_last_passes_over_what_is_no_task(between):
    """A person who pauses, asks or tests in between still means the task before."""
    s = Harness()
    s.analyzing()
    s.says(between, client="ann")
    s.says("STOW AFTER LAST", client="ann")
    assert s.state.commands["C-3"].previous == "C-1"


def test_after_last_of_one_that_has_failed_is_refused():
    s = Harness()
    s.analyzing()
    s.answers("C-1", give_up())
    s.parsed(after="LAST")
    assert s.outcome("C-2").refusal.reason is RefusalReason.STATE


def test_after_last_without_one_before_is_refused():
    s = Harness()
    s.says("X", client="bob")
    s.parsed(after="LAST")

    refusal = s.outcome("C-2").refusal
    assert (refusal.reason, refusal.where) == (RefusalReason.NAME, "LAST")
    assert "AFTER C-n" in in_one_line(refusal.clears)


@pytest.mark.parametrize(("relation", "word"), [("after", "AFTER"), ("together_with", "TOGETHER-WITH")])
def test_last_in_another_rtc_do_is_refused_with_the_reason_and_what_to_write(relation, word):
    """The second `rtc do` of one person has a client of its own; the first one's command is still under way."""
    s = Harness()
    s.analyzing()
    s.says(f"STOW {word} LAST", client="another rtc do")
    s.answers("C-2", record(**{relation: "LAST"}))

    refusal = s.outcome("C-2").refusal
    assert (refusal.reason, refusal.where) == (RefusalReason.NAME, "LAST")
    assert "each `rtc do` is a client of its own" in refusal.message  # wording: what people do not expect
    assert in_one_line(refusal.clears).startswith("both sentences in one `rtc do`")
    assert f"{word} C-n" in in_one_line(refusal.clears)


def test_the_latest_commands_of_many_clients_are_bounded():
    s = Harness()
    for n in range(CLIENTS_KEPT + 5):
        s.says("STOW", client=f"client-{n}")
    assert len(s.state.last_given) == CLIENTS_KEPT


# --- report, and how long a step takes ----------------------------------------------------------------


def test_after_a_failure_is_refused():
    s = Harness()
    s.analyzing()
    s.parsed(after="C-1")
    s.answers("C-1", give_up())
    assert s.outcome("C-2").refusal.reason is RefusalReason.STATE


def test_after_one_that_has_ended_already():
    s = Harness()
    s.analyzing()
    s.answers("C-1", go_on())
    s.parsed(after="C-1")
    assert s.phase("C-2") == "elaborating"


def test_a_circle_of_afters_is_refused():
    s = Harness()
    s.says("A AFTER C-2")
    s.says("B AFTER C-1")
    s.answers("C-1", record(after="C-2"))
    s.answers("C-2", record(after="C-1"))
    assert s.outcome("C-2").refusal.reason is RefusalReason.STATE


def test_together_with_starts_when_the_other_begins_to_move():
    s = Harness()
    s.elaborated()
    s.says("X TOGETHER-WITH C-1")
    assert s.answers("C-2", record(hand="LEFT-ARM", together_with="C-1")) == ["note C-2 held"]
    assert s.answers("C-1", bound("C-1.1"))[-2:] == ["job C-2/2 elaborator #1", "note C-2 elaborating"]
