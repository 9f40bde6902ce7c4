"""The rare cells of the five tables, each by its events. The common ones are in the files of the machines."""

from __future__ import annotations

import pytest

from broker.decisions.deferred_analysis import DEFERRED
from broker.decisions.effects import ReportEnd
from broker.decisions.events import BrokerRestarted, JobDeclined, ProgramInstalled
from broker.decisions.halt_request import HALT
from broker.decisions.program_rollout import ROLLOUT
from broker.decisions.state import Deferral, HaltPhase, JobKind, LinkState, RolloutPhase
from broker.decisions.subsystem_link import LINK
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason, StopReason
from tests.broker.harness import Harness, bound, go_on, script


def test_names_that_are_not_stored_are_in_the_first_state_of_their_machine():
    state = Harness().state
    assert [machine.state_of(state, "nothing") for machine in (LINK, HALT, DEFERRED, ROLLOUT)] == [
        LinkState.UNKNOWN,
        HaltPhase.NEW,
        Deferral.NONE,
        RolloutPhase.NONE,
    ]


# --- command -----------------------------------------------------------------------------------------


def reach(s: Harness, phase: str) -> str:
    """A command of two steps in this phase."""
    if phase == "held":
        s.executing()
        s.parsed(after="C-1")
    elif phase == "parsing":
        s.says("X")
    elif phase == "elaborating":
        s.parsed()
    else:
        {"binding": s.elaborated, "executing": s.executing, "analyzing": s.analyzing}[phase](script(steps=2))
    return f"C-{s.state.accepted}"


@pytest.mark.parametrize("phase", ["parsing", "elaborating", "held", "binding", "executing", "analyzing"])
def test_a_pause_may_be_requested_and_withdrawn_before_it_takes_effect(phase):
    s = Harness()
    command = reach(s, phase)
    s.parsed("PAUSE", kind="control", verb="PAUSE", object=command)
    assert s.state.commands[command].pause_wanted
    s.parsed("RESUME", kind="control", verb="RESUME", object=command)
    assert (s.phase(command), s.state.commands[command].pause_wanted) == (phase, False)


def paused(s: Harness) -> None:
    s.analyzing(script(steps=2))
    s.parsed(kind="control", verb="PAUSE", object="C-1")
    s.answers("C-1", go_on())


def binding_its_second_step(s: Harness) -> None:
    s.analyzing(script(steps=2))
    s.answers("C-1", go_on())


@pytest.mark.parametrize("between", [paused, binding_its_second_step])
def test_a_command_between_two_steps_ends_with_its_subsystem(between):
    s = Harness()
    between(s)
    assert s.mcm_gone()[-1] == "end C-1 lost_subsystem"
    assert s.outcome("C-1").kind is OutcomeKind.LOST_SUBSYSTEM


def closing(s: Harness) -> None:
    s.executing()
    s.halts()
    s.reports("C-1", StopReason.HALT)
    assert s.phase("C-1") == "closing"


def test_a_refused_last_analysis_does_not_change_the_outcome():
    s = Harness()
    closing(s)
    assert s.declines("C-1")[-2:] == ["end C-1 halted", "timer C-1/4"]
    assert s.state.deferred_analyses["C-1"].job.kind is JobKind.SUSPECT


def test_a_last_analysis_that_kills_its_workers_does_not_change_the_outcome():
    s = Harness()
    closing(s)
    for _ in range(2):
        s.loses_worker("C-1")
        assert s.phase("C-1") == "closing"
    assert s.loses_worker("C-1")[-2:] == ["end C-1 halted", "timer C-1/4"]
    assert s.state.deferred_analyses["C-1"].job.kind is JobKind.SUSPECT


# --- deferred analysis -------------------------------------------------------------------------------


def deferred(s: Harness) -> None:
    """An analysis that waits for its next attempt."""
    closing(s)
    s.declines("C-1", RefusalReason.TIMEOUT)
    assert s.state.deferred_analyses["C-1"].phase is Deferral.WAITING
    assert "RIGHT-ARM" in s.state.resources.quarantine


def test_a_restart_repeats_a_deferred_analysis_at_once():
    s = Harness()
    deferred(s)
    assert [e for e in s.handle(BrokerRestarted) if e.startswith("job C-1")] == [
        "job C-1/4 analyzer #3 lease RIGHT-ARM"
    ]
    assert s.state.deferred_analyses["C-1"].phase is Deferral.RUNNING


def test_a_refused_deferred_analysis_opens_the_arm_when_its_facts_are_suspect():
    s = Harness()
    deferred(s)
    s.rings("C-1/4")
    job = s.state.deferred_analyses["C-1"].job
    refusal = Refusal(reason=RefusalReason.INFEASIBLE, message="no")
    for _ in range(2):  # a refusal of the doubt is retried too
        s.handle(JobDeclined, job=job.id, attempt=job.attempt, node="worker", refusal=refusal)
        assert "RIGHT-ARM" in s.state.resources.quarantine
        assert s.rings("C-1/4") == [f"job C-1/4 analyzer #{job.attempt} lease RIGHT-ARM doubt"]
    s.tells("C-1")
    assert (s.state.deferred_analyses, s.state.resources.quarantine) == ({}, {})
    assert s.state.counts["analyses_given_up"] == 1


# --- HALT request ------------------------------------------------------------------------------------


def test_a_declined_halt_is_obeyed_when_it_comes_again_and_its_scope_is_known():
    s = Harness()
    assert s.halts("C-1") == ["decline halt h1"]
    s.executing()
    assert s.halts("C-1")[0] == "halt C-1 to MCM"
    assert s.state.counts["halts"] == 1


def test_a_halt_sentence_ends_with_the_subsystem_that_should_confirm_it():
    s = Harness()
    s.says("HALT ALL")
    s.mcm_gone()
    assert s.outcome("C-1").kind.value == "halt_not_confirmed"
    assert s.state.halt_sentences == {}


def test_the_trace_of_a_halt_sentence_names_who_confirmed_rest():
    s = Harness()
    s.says("HALT ALL")
    s.rests("C-1")
    (end,) = (e.record for e in s.log if isinstance(e, ReportEnd))
    assert (end.outcome.kind, end.notes[-1].node) == ("succeeded", "MCM")


def test_a_halt_sentence_ends_when_something_in_scope_is_not_at_rest():
    s = Harness()
    s.says("HALT ALL")
    s.rests("C-1", at_rest=False)
    assert s.outcome("C-1").kind is OutcomeKind.HALT_NOT_CONFIRMED


# --- subsystem link ----------------------------------------------------------------------------------


@pytest.mark.parametrize("come", [lambda s: s.mcm_hello(pid=2), Harness.mcm_gone], ids=["new process", "gone"])
def test_a_subsystem_that_died_with_the_broker_ends_its_commands(come):
    s = Harness()
    s.executing()
    s.handle(BrokerRestarted)
    assert s.state.subsystems["MCM"].link is LinkState.AWAITED
    come(s)
    assert s.phase("C-1") == "closing"
    assert s.state.commands["C-1"].pending_outcome.kind.value == "lost_subsystem"


def test_a_lost_subsystem_stays_lost_over_a_restart_until_it_connects():
    s = Harness()
    s.mcm_gone()
    s.handle(BrokerRestarted)
    assert s.state.subsystems["MCM"].link is LinkState.LOST
    s.mcm_hello()
    assert s.state.subsystems["MCM"].link is LinkState.CONNECTED


# --- program roll-out --------------------------------------------------------------------------------


def test_a_program_goes_from_its_trial_to_proven_and_needs_no_second_trial():
    s = Harness()
    phases = []
    for digest in ("first", "second", "first", "second"):
        s.handle(ProgramInstalled, kind=WorkerKind.BINDER, digest=digest)
        phases.append(s.state.rollouts["binder"].phase.value)
        command = s.elaborated()
        s.answers(command, bound(f"{command}.1"))
        s.reports(command)
        s.answers(command, go_on())
        assert s.state.rollouts["binder"].phase is RolloutPhase.PROVEN
    assert phases == ["proven", "trial", "proven", "proven"]
