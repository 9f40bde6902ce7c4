"""ABORT, PAUSE and RESUME."""

from __future__ import annotations

import pytest

from broker.decisions.events import (
    PrimitivePaced,
)
from rtc.protocol.messages import NoteKind
from rtc.protocol.outcomes import OutcomeKind, RefusalReason, StopReason
from rtc.wording.advice import in_one_line
from tests.broker.harness import Harness, go_on, record, script

# --- abort, pause, resume -----------------------------------------------------------------------------


def test_abort_stops_one_command():
    s = Harness()
    s.executing()
    s.says("ABORT C-1")
    assert s.answers("C-2", record(kind="control", verb="ABORT", object="C-1")) == [
        "note C-2 ended",
        "end C-2 succeeded",
        "halt C-1 to MCM",
        "timer C-1",
        "note C-1 halting",
    ]
    s.reports("C-1", StopReason.HALT)
    assert s.answers("C-1", go_on())[-1] == "end C-1 aborted"


def test_pause_takes_effect_between_two_steps_and_resume_goes_on():
    s = Harness()
    s.executing(script(steps=2))
    s.parsed(kind="control", verb="PAUSE", object="C-1")
    s.reports("C-1")
    assert s.answers("C-1", go_on()) == ["note C-1 analyzing", "note C-1 paused"]
    s.says("RESUME C-1")
    assert s.answers("C-3", record(kind="control", verb="RESUME", object="C-1"))[2:] == [
        "note C-1 paused",
        "job C-1/5 binder #1",
        "note C-1 binding",
    ]


@pytest.mark.parametrize(
    ("verb", "before", "message"),
    [
        ("PAUSE", [], "C-1 pauses after step 1 of 2: step 1"),
        ("PAUSE", ["PAUSE"], "C-1 pauses after step 1 of 2: step 1"),
        ("RESUME", [], "C-1 was not paused"),
        ("RESUME", ["PAUSE"], "C-1 goes on"),
    ],
)
def test_the_answer_to_pause_or_resume_states_what_will_happen(verb, before, message):
    s = Harness()
    s.executing(script(steps=2))
    for word in [*before, verb]:
        command = s.parsed(kind="control", verb=word, object="C-1")
    outcome = s.outcome(command)
    assert outcome.message == message  # wording: it is the answer
    assert outcome.kind is (OutcomeKind.REFUSED if "not" in message else OutcomeKind.SUCCEEDED)


def test_a_pause_in_the_last_step_is_refused():
    s = Harness()
    s.executing(script(steps=1))
    outcome = s.outcome(s.parsed(kind="control", verb="PAUSE", object="C-1"))
    assert outcome.refusal is not None
    assert outcome.kind is OutcomeKind.REFUSED
    assert outcome.refusal.reason is RefusalReason.STATE
    assert "HALT C-1" in in_one_line(outcome.refusal.clears)


def moving() -> Harness:
    """A command in its only step, on a subsystem that can pause it on its path."""
    s = Harness(mcm=False)
    s.mcm_hello(pauses=True)
    s.executing(script(steps=1))
    return s


def test_a_motion_pauses_on_its_path_and_goes_on_even_in_the_last_step():
    s = moving()
    s.says("PAUSE C-1")
    assert s.answers("C-2", record(kind="control", verb="PAUSE", object="C-1"))[2:] == [
        "note C-1 executing",
        "pause C-1.1 at MCM",
    ]
    assert s.outcome("C-2").kind is OutcomeKind.SUCCEEDED
    s.handle(PrimitivePaced, subsystem="MCM", primitive="C-1.1", paused=True, done=0.4)
    stands = s.state.commands["C-1"].notes[-1]
    assert (stands.kind, stands.value) == (NoteKind.STANDS, 0.4)
    s.says("RESUME C-1")
    answers = s.answers("C-3", record(kind="control", verb="RESUME", object="C-1"))
    assert answers[2:] == ["timer C-1", "go on C-1.1 at MCM"]
    s.reports("C-1")
    assert s.answers("C-1", go_on())[-1] == "end C-1 succeeded"


def test_a_motion_that_stands_is_shown_as_paused_and_not_paused_again():
    s = moving()
    s.parsed(kind="control", verb="PAUSE", object="C-1")
    s.handle(PrimitivePaced, subsystem="MCM", primitive="C-1.1", paused=True, done=0.4)
    command = s.state.commands["C-1"]
    assert (command.phase, command.shown_phase) == ("executing", "paused")
    assert "40%" in command.shown_step
    again = s.outcome(s.parsed(kind="control", verb="PAUSE", object="C-1"))
    assert again.refusal is not None
    assert in_one_line(again.refusal.clears).startswith("RESUME C-1")
    s.parsed(kind="control", verb="RESUME", object="C-1")
    late = s.outcome(s.parsed(kind="control", verb="PAUSE", object="C-1"))  # before it has gone on
    assert late.kind is OutcomeKind.SUCCEEDED
    s.parsed(kind="control", verb="RESUME", object="C-1")
    s.handle(PrimitivePaced, subsystem="MCM", primitive="C-1.1", paused=False)
    assert command.shown_phase == "executing"
    assert command.shown_step == command.step_words


def test_the_time_limit_of_a_report_waits_for_the_end_of_a_pause():
    s = moving()
    s.parsed(kind="control", verb="PAUSE", object="C-1")
    assert s.rings("C-1") == ["timer C-1"]
    s.parsed(kind="control", verb="RESUME", object="C-1")
    assert "halt C-1 to MCM" in s.rings("C-1")


def test_a_motion_that_ends_before_it_stands_pauses_before_the_next_step():
    s = Harness(mcm=False)
    s.mcm_hello(pauses=True)
    s.executing(script(steps=2))
    s.parsed(kind="control", verb="PAUSE", object="C-1")
    s.reports("C-1")
    assert s.answers("C-1", go_on()) == ["note C-1 analyzing", "note C-1 paused"]


@pytest.mark.parametrize("paused", [[], ["C-1.1"]])
@pytest.mark.parametrize("wanted", [True, False])
def test_a_pause_order_that_was_lost_is_sent_again(paused, wanted):
    s = moving()
    s.state.commands["C-1"].pause_wanted = wanted
    sent = s.mcm_hello(outstanding=["C-1.1"], at_rest=False, pauses=True, paused=paused)
    expected = [] if wanted is bool(paused) else ["pause C-1.1 at MCM" if wanted else "go on C-1.1 at MCM"]
    assert sent == expected


def test_a_motion_that_pauses_can_be_halted():
    s = moving()
    s.parsed(kind="control", verb="PAUSE", object="C-1")
    s.halts()
    s.reports("C-1", StopReason.HALT)
    assert s.answers("C-1", go_on())[-1] == "end C-1 halted"


def test_a_command_that_is_being_halted_is_not_resumed():
    """It would be accepted and without effect."""
    s = moving()
    s.parsed(kind="control", verb="PAUSE", object="C-1")
    s.halts()
    resume = s.parsed(kind="control", verb="RESUME", object="C-1")
    assert s.outcome(resume).kind is OutcomeKind.REFUSED
    assert s.outcome(resume).refusal.reason is RefusalReason.STATE
    assert s.outcome(resume).refusal.clears


def test_a_paused_command_can_be_halted():
    s = Harness()
    s.executing(script(steps=2))
    s.parsed(kind="control", verb="PAUSE", object="ALL")
    s.reports("C-1")
    s.answers("C-1", go_on())
    assert s.halts()[-1] == "end C-1 halted"


def test_control_of_a_command_that_is_not_there_is_refused():
    s = Harness()
    s.parsed(kind="control", verb="ABORT", object="C-7")
    assert s.outcome("C-1").refusal.reason is RefusalReason.NAME


# --- words --------------------------------------------------------------------------------------------


def test_a_control_word_that_finds_nothing_says_so():
    s = Harness()
    s.parsed(kind="control", verb="ABORT", object="ALL")
    assert s.outcome("C-1").kind is OutcomeKind.SUCCEEDED
    assert "nothing" in s.outcome("C-1").message  # wording: it is the answer


@pytest.mark.parametrize("verb", ["PAUSE", "RESUME", "ABORT"])
def test_an_idle_arm_is_nothing_to_act_on_and_an_unknown_name_is_refused(verb):
    """Nothing is left to abort, so ABORT has its effect. PAUSE and RESUME have none."""
    s = Harness()
    s.parsed(kind="control", verb=verb, hand="RIGHT-ARM")
    s.parsed(kind="control", verb=verb, object="NOWHERE")
    kind = "succeeded" if verb == "ABORT" else "refused"
    assert s.outcome("C-1").kind == kind
    assert s.outcome("C-2").refusal.reason == "name"
