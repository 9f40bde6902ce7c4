"""Subsystems that are lost, come back, or do not report in time."""

from __future__ import annotations

from broker.decisions.command import closing, stopping
from broker.decisions.resources import WORLD
from rtc.protocol.advice import by_sentence
from rtc.protocol.messages import Assessment
from rtc.protocol.outcomes import OutcomeKind, StopReason
from tests.broker.harness import Harness, bound, go_on

# --- words --------------------------------------------------------------------------------------------


def test_a_lost_subsystem_says_what_leads_on():
    s = Harness()
    s.executing()
    s.mcm_gone()
    s.answers("C-1", go_on())
    assert (s.outcome("C-1").kind, s.outcome("C-1").refusal.clears) == (
        OutcomeKind.LOST_SUBSYSTEM,
        stopping.RETRY_ADVICE,
    )


def test_a_lost_subsystem_says_how_the_facts_are_trusted_again_before_the_sentence_is_repeated():
    s = Harness()
    s.executing()
    s.mcm_gone()
    check = by_sentence("VERIFY X AT RIGHT-ARM")
    s.answers("C-1", Assessment(verdict="abort", reason=StopReason.SUBSYSTEM_LOST, clears=check))
    (advised,) = s.outcome("C-1").refusal.clears
    assert (advised.sentences, advised.again) == (["VERIFY X AT RIGHT-ARM"], True)
    assert closing.WHEN_BACK in advised.words


# --- subsystems ---------------------------------------------------------------------------------------


def test_a_lost_subsystem_ends_what_it_executed_and_closes_its_arms_until_it_confirms_rest():
    s = Harness()
    s.executing()
    assert s.mcm_gone() == [
        "no timer C-1",
        "job C-1/4 analyzer #1 lease RIGHT-ARM",
        "timer C-1",
        "note C-1 closing",
    ]
    assert s.answers("C-1", go_on()) == ["no timer C-1", "note C-1 ended", "end C-1 lost_subsystem"]
    assert s.state.resources.quarantine == {"RIGHT-ARM": ("MCM", "C-1.1")}
    s.mcm_hello(pid=2)
    assert s.state.resources.quarantine == {}


def test_a_subsystem_that_comes_back_before_the_command_is_closed_leaves_no_quarantine():
    s = Harness()
    s.executing()
    s.mcm_hello(pid=2)
    assert s.phase("C-1") == "closing"
    s.answers("C-1", go_on())
    assert s.outcome("C-1").kind is OutcomeKind.LOST_SUBSYSTEM
    assert s.state.resources.quarantine == {}


def test_a_subsystem_that_was_only_stopped_is_halted_when_it_comes_back():
    s = Harness()
    s.executing()
    s.mcm_gone()
    s.answers("C-1", go_on())
    assert s.mcm_hello(outstanding=["C-1.1"], at_rest=False) == ["halt C-1 to MCM"]
    assert s.state.resources.quarantine == {"RIGHT-ARM": ("MCM", "C-1.1")}
    s.rests("orphan-C-1.1")
    assert s.state.resources.quarantine == {}


def test_nothing_is_sent_to_a_subsystem_that_is_lost():
    s = Harness()
    s.elaborated()
    s.mcm_gone()
    assert s.answers("C-1", bound("C-1.1")) == ["note C-1 ended", "end C-1 lost_subsystem"]


def test_a_subsystem_lost_while_halting():
    s = Harness()
    s.executing()
    s.halts()
    s.mcm_gone()
    assert s.answers("C-1", go_on())[-1] == "end C-1 halt_not_confirmed"


def test_no_end_report_within_the_limit_stops_the_subsystem_and_fails():
    s = Harness()
    s.executing()
    assert s.rings("C-1") == ["halt C-1 to MCM", "timer C-1", "note C-1 halting"]
    s.reports("C-1", StopReason.HALT)
    assert s.answers("C-1", go_on())[-1] == "end C-1 failed"


def test_a_last_analysis_that_never_comes_does_not_keep_the_command_but_what_it_touched():
    s = Harness()
    s.executing()
    s.halts()
    s.reports("C-1", StopReason.HALT)
    assert s.rings("C-1") == ["no timer C-1", "note C-1 ended", "end C-1 halted"]
    assert s.state.resources.quarantine == {"RIGHT-ARM": (WORLD, "C-1")}
    s.parsed()
    assert s.phase("C-2") == "held"
    assert s.tells("C-1") == ["job C-2/2 elaborator #1", "note C-2 elaborating"]
    assert (s.state.deferred_analyses, s.state.resources.quarantine) == ({}, {})
