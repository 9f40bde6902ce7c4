"""TEST sentences in the Decision Unit: one job, no claim, no primitive; and sentences given after their test."""

from __future__ import annotations

import msgspec
import pytest

from broker.decisions import events
from broker.decisions.command import rehearsal
from broker.decisions.effects import DispatchJob
from rtc.protocol import wire
from rtc.protocol.messages import ElaboratorInput, RehearsalInput, WorkerKind
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason
from rtc.protocol.rehearsal import RehearsedStep
from rtc.protocol.versions import RIGID
from tests.broker.harness import Harness, go_on, record, rehearsed
from tests.simulation.invariants import violations

MOVE, STOW = record(verb="MOVE"), record(verb="STOW")
INFEASIBLE = Refusal(reason=RefusalReason.INFEASIBLE, message="out of reach")


def given(s: Harness, digest: str, parsed=MOVE) -> str:
    """Give a sentence on the strength of a test; returns its number."""
    s.says("X", if_tested=digest)
    command = f"C-{s.state.accepted}"
    s.answers(command, parsed)
    return command


def rests_on(s: Harness, command: str):
    data: ElaboratorInput = wire.decoder(ElaboratorInput)(s.state.commands[command].job.input)
    return data.rests_on


# --- the rehearsal -------------------------------------------------------------------------------------


def test_a_test_is_one_job_of_a_rehearser_and_claims_nothing():
    s = Harness()
    s.says("TEST X")
    assert s.answers("C-1", record(test=True)) == ["job C-1/2 rehearser #1", "note C-1 rehearsing"]
    assert (s.state.resources.held, violations(s.state)) == ({}, [])
    assert s.answers("C-1", rehearsed(record())) == ["note C-1 ended", "end C-1 succeeded"]
    assert s.outcome("C-1").rehearsal.predicted_s == 2.0


def test_its_job_has_the_programs_of_all_kinds():
    s = Harness()
    for kind in WorkerKind:
        s.handle(events.ProgramInstalled, kind=kind, digest=f"{kind}-1")
    s.says("TEST X")
    s.answers("C-1", record(test=True))
    job = next(e for e in reversed(s.log) if isinstance(e, DispatchJob))
    assert job.programs == {kind: f"{kind}-1" for kind in WorkerKind}


def test_its_job_names_the_arms_that_cannot_comply():
    s = Harness()
    s.handle(events.SubsystemConnected, subsystem="EXACT", pid=2, performers=["ARM-3"], abilities=[RIGID])
    s.says("TEST X")
    s.answers("C-1", record(test=True))
    data = wire.decoder(RehearsalInput)(s.state.commands["C-1"].job.input)
    assert data.rigid == ["ARM-3"]


def test_an_infeasible_sentence_is_refused_with_its_step():
    s = Harness()
    s.says("TEST X")
    s.answers("C-1", record(test=True))
    s.answers("C-1", msgspec.structs.replace(rehearsed(record(), INFEASIBLE), step="2 of 3: go"))
    outcome = s.outcome("C-1")
    assert (outcome.kind, outcome.refusal, outcome.step) == (OutcomeKind.REFUSED, INFEASIBLE, "2 of 3: go")


def test_its_job_names_an_earlier_command_that_has_succeeded():
    s = Harness()
    s.analyzing()
    s.answers("C-1", go_on())
    for words, live in (({"after": "C-1"}, ["C-1"]), ({"together_with": "C-1"}, []), ({"after": "C-7"}, [])):
        s.says("TEST X")
        command = f"C-{s.state.accepted}"
        s.answers(command, record(test=True, **words))
        assert wire.decoder(RehearsalInput)(s.state.commands[command].job.input).live == live


def test_a_sentence_that_lasts_has_no_time():
    s = Harness()
    s.says("TEST X")
    s.answers("C-1", record(test=True))
    found = rehearsed(record())
    step = RehearsedStep(label="hold", until_stopped=True)
    lasting = msgspec.structs.replace(found.rehearsal, steps=[step], predicted_s=0.0)
    s.answers("C-1", msgspec.structs.replace(found, rehearsal=lasting))
    assert s.outcome("C-1").kind is OutcomeKind.SUCCEEDED
    assert "0.0 s" not in s.outcome("C-1").message  # wording: no time is foretold


def test_it_runs_beside_a_command_that_uses_the_same_arm():
    s = Harness()
    s.executing()
    s.tested()
    assert s.phase("C-1") == "executing"
    assert s.outcome("C-2").rehearsal.in_use == {"RIGHT-ARM": "C-1"}


def test_now_is_refused_while_the_arm_is_in_use():
    s = Harness()
    s.executing()
    s.tested(parsed=record(now=True))
    assert (s.outcome("C-2").kind, s.outcome("C-2").refusal.owner) == (OutcomeKind.REFUSED, "C-1")


@pytest.mark.parametrize("verb", ["HALT", "PAUSE", "ABORT"])
def test_the_test_of_a_control_stops_nothing(verb):
    s = Harness()
    s.executing()
    s.tested(f"TEST {verb}", parsed=record("control", verb))
    assert s.phase("C-1") == "executing"


def test_a_lost_rehearser_repeats_the_job():
    s = Harness()
    s.says("TEST X")
    s.answers("C-1", record(test=True))
    assert s.loses_worker("C-1") == ["note C-1 rehearsing", "job C-1/2 rehearser #2"]
    assert s.handle(events.BrokerRestarted)[0] == "job C-1/2 rehearser #3"


def test_a_halt_ends_a_test_and_a_pause_is_refused():
    s = Harness()
    s.says("TEST X")
    s.answers("C-1", record(test=True))
    s.says("PAUSE C-1")
    s.answers("C-2", record("control", "PAUSE", object="C-1"))
    assert s.outcome("C-2").kind is OutcomeKind.REFUSED
    s.halts()
    assert s.outcome("C-1").kind is OutcomeKind.HALTED


def test_a_program_on_trial_is_neither_proven_nor_rolled_back_by_a_test():
    s = Harness()
    for digest in ("old", "new"):
        s.handle(events.ProgramInstalled, kind=WorkerKind.ELABORATOR, digest=digest)
    s.tested()
    assert s.state.rollouts["elaborator"].phase == "trial"
    s.says("TEST X")
    s.answers("C-2", record(test=True))
    s.loses_worker("C-2")
    assert s.state.programs["elaborator"] == "new"


# --- lists of sentences --------------------------------------------------------------------------------


def test_the_next_sentence_is_rehearsed_in_the_world_after_the_test():
    s = Harness()
    first = s.tested()
    s.says("TEST Y", after_test=first, label="C-5")
    s.answers("C-2", record(test=True))
    data: RehearsalInput = wire.decoder(RehearsalInput)(s.state.commands["C-2"].job.input)
    assert data.before is not None
    assert (data.before.at_s, data.label) == (2.0, "C-5")


def test_an_unknown_digest_is_refused():
    s = Harness()
    s.says("TEST Y", after_test="nothing")
    s.answers("C-1", record(test=True))
    assert s.outcome("C-1").refusal.reason is RefusalReason.STALE


def test_only_a_test_may_follow_a_test():
    s = Harness()
    s.says("Y", after_test=s.tested())
    s.answers("C-2", record())
    assert s.outcome("C-2").kind is OutcomeKind.REFUSED


def test_equal_tests_have_equal_digests_and_others_differ():
    s = Harness()
    first = s.tested(relies_on={"A.frame": 3})
    assert first == s.tested(relies_on={"A.frame": 3})
    assert len({first, s.tested(relies_on={"A.frame": 4}), s.tested(after=first), s.tested(parsed=STOW)}) == 4


def test_the_number_of_known_tests_is_limited(monkeypatch):
    monkeypatch.setattr(rehearsal, "TESTS_KEPT", 2)
    s = Harness()
    digests = [s.tested(relies_on={"A.frame": n}) for n in range(3)]
    assert list(s.state.tested) == digests[1:]


# --- given on the strength of a test -------------------------------------------------------------------


def test_the_elaborator_compares_what_the_test_rests_on():
    s = Harness()
    command = given(s, s.tested(parsed=MOVE, relies_on={"A.frame": 3}))
    assert rests_on(s, command).relies_on == {"A.frame": 3}


def test_commands_of_sentences_before_it_may_change_the_facts():
    s = Harness()
    digest = s.tested(parsed=STOW, after=s.tested(parsed=MOVE))
    first, second = given(s, digest, MOVE), None
    s.declines(first)
    second = given(s, digest, STOW)
    assert (rests_on(s, second).given, s.state.tested[digest].given) == ([first], [second])
    s.declines(second)
    again = given(s, digest, MOVE)  # out of order: what the second sentence has changed is not foreseen by the first
    assert rests_on(s, again).given == []


def test_a_sentence_that_occurs_twice_is_matched_in_order():
    s = Harness()
    digest = s.tested(parsed=MOVE, after=s.tested(parsed=MOVE, relies_on={"A.frame": 1}), relies_on={"A.frame": 2})
    first = given(s, digest)
    assert rests_on(s, first).relies_on == {"A.frame": 1}
    s.declines(first)
    assert rests_on(s, given(s, digest)).relies_on == {"A.frame": 2}


@pytest.mark.parametrize("why", ["unknown", "another sentence", "not feasible", "another program"])
def test_a_sentence_that_the_test_does_not_cover_is_stale(why):
    s = Harness()
    digest = s.tested(parsed=MOVE, refusal=INFEASIBLE if why == "not feasible" else None)
    if why == "another program":
        s.handle(events.ProgramInstalled, kind=WorkerKind.BINDER, digest="new")
    command = given(s, "nothing" if why == "unknown" else digest, STOW if why == "another sentence" else MOVE)
    assert s.outcome(command).refusal.reason is RefusalReason.STALE
