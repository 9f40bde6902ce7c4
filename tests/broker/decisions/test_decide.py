"""Every row of the table, effect by effect and in order; then the stories that cross rows."""

from __future__ import annotations

import msgspec
import pytest

from broker.decisions import effects as do
from broker.decisions.command import stopping, termination
from broker.decisions.command.limits import CLOSING_LIMIT_S, REPORT_MARGIN_S
from broker.decisions.command.table import COMMAND, stimulate
from broker.decisions.context import DecisionContext
from broker.decisions.decide import CLIENTS_KEPT
from broker.decisions.effects import PublishHalt, PublishNote, ReportEnd, SendHalt, SendPrimitive
from broker.decisions.events import (
    BrokerRestarted,
    ClientGone,
    HaltCalled,
    HaltConfirmed,
    ListenersChanged,
    PrimitivePaced,
    ProgramInstalled,
    Stimulus,
    SubsystemConnected,
    TimerFired,
)
from broker.decisions.machine import InvalidTransition
from broker.decisions.resources import WORLD
from broker.decisions.state import RolloutPhase, State
from rtc.language.record import Report
from rtc.protocol import wire
from rtc.protocol.messages import AnalyzerInput, BinderInput, BoundStep, ElaboratorInput, Phase, WorkerKind
from rtc.protocol.outcomes import OutcomeKind, RefusalReason, StopReason
from tests.broker.harness import Harness, bound, give_up, go_on, mend, record, report, script, stated, trim

# --- the nominal journey -----------------------------------------------------------------------------


def test_one_command_all_the_way():
    s = Harness()
    assert s.says("GRASP") == ["tell ann Accepted C-1", "job C-1/1 parser #1", "note C-1 parsing"]
    assert s.answers("C-1", record()) == ["job C-1/2 elaborator #1", "note C-1 elaborating"]
    assert s.answers("C-1", script()) == ["job C-1/3 binder #1", "note C-1 binding"]
    assert s.answers("C-1", bound("C-1.1")) == ["primitive C-1.1 to MCM", "timer C-1", "note C-1 executing"]
    assert s.reports("C-1") == [
        "no timer C-1",
        "ack C-1.1",
        "job C-1/4 analyzer #1 lease RIGHT-ARM",
        "note C-1 analyzing",
    ]
    assert s.answers("C-1", go_on()) == ["note C-1 analyzing", "note C-1 ended", "end C-1 succeeded"]
    assert s.state.commands == {}
    assert s.state.resources.held == {}


def test_each_step_is_bound_after_the_one_before_was_analysed():
    s = Harness()
    s.analyzing(script(steps=2))
    assert s.answers("C-1", go_on()) == ["note C-1 analyzing", "job C-1/5 binder #1", "note C-1 binding"]
    assert s.answers("C-1", bound("C-1.2"))[0] == "primitive C-1.2 to MCM"


def test_a_step_without_a_primitive_is_passed_through():
    s = Harness()
    s.elaborated(script(steps=2))
    assert s.answers("C-1", BoundStep(note="GP set")) == ["note C-1 binding", "job C-1/4 binder #1", "note C-1 binding"]


@pytest.mark.parametrize("name", ["X-9.1", "C-2.1", "C-1.2", ""])
def test_a_primitive_of_another_name_is_not_sent(name):
    """A halt of its command would not find it, and its report would belong to no command."""
    s = Harness()
    s.elaborated(script())
    assert not [line for line in s.answers("C-1", bound(name)) if line.startswith("primitive")]
    refusal = s.outcome("C-1").refusal
    assert refusal.reason is RefusalReason.PROGRAM
    assert "which is not the next one of C-1" in refusal.message


def test_a_primitive_that_no_subsystem_could_read_is_not_sent():
    s = Harness()
    s.elaborated(script())
    product = msgspec.to_builtins(bound("C-1.1"))
    product["primitive"]["stop_functions"] = []
    assert not [line for line in s.answers("C-1", product) if line.startswith("primitive")]
    refusal = s.outcome("C-1").refusal
    assert refusal.reason is RefusalReason.PROGRAM
    assert "F is not complete" in refusal.message


def test_a_primitive_that_no_analyzer_could_judge_is_not_sent():
    s = Harness()
    s.elaborated(script())
    product = msgspec.structs.replace(bound("C-1.1"), evaluation=None)
    assert not [line for line in s.answers("C-1", product) if line.startswith("primitive")]
    assert s.outcome("C-1").refusal.reason is RefusalReason.PROGRAM


def test_stated_facts_go_straight_to_an_analyzer():
    """A24: it is a report like any other, but nothing moves for it: no subsystem, no acknowledgement, no timer."""
    s = Harness(mcm=False)
    s.elaborated(script(resources=("MODULE",)))
    assert s.answers("C-1", stated(2.1)) == ["job C-1/4 analyzer #1 lease MODULE", "note C-1 analyzing"]
    given = wire.decoder(AnalyzerInput)(s.state.commands["C-1"].job.input)
    assert given.report.facts == {"MODULE.mass": 2.1}
    assert given.evaluation.step.do == "tell"
    assert s.answers("C-1", go_on()) == ["note C-1 analyzing", "note C-1 ended", "end C-1 succeeded"]


def test_elaborator_and_binder_receive_the_time_of_their_job():
    """What a hand holds is less certain with time, so both need the age of its facts."""
    s = Harness()
    s.now = 100.0
    s.says("GRASP MODULE")
    s.answers("C-1", record())
    command = s.state.commands["C-1"]
    assert wire.decoder(ElaboratorInput)(command.job.input).at_s == s.now
    s.answers("C-1", script())
    assert wire.decoder(BinderInput)(command.job.input).at_s == s.now


def test_a_step_that_tells_may_stand_between_two_that_move():
    s = Harness()
    s.analyzing(script(steps=3))
    s.answers("C-1", go_on())
    assert s.answers("C-1", stated())[-1] == "note C-1 analyzing"
    assert s.answers("C-1", go_on())[1:] == ["job C-1/7 binder #1", "note C-1 binding"]
    assert s.answers("C-1", bound("C-1.2"))[0] == "primitive C-1.2 to MCM"


def test_a_script_without_steps_succeeds_at_once():
    s = Harness()
    s.parsed()
    assert s.answers("C-1", script(steps=0)) == ["note C-1 ended", "end C-1 succeeded"]


# --- refusals ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("reach", ["says", "parsed", "elaborated"])
def test_a_refusal_ends_the_command(reach):
    s = Harness()
    getattr(s, reach)(*["X"] if reach == "says" else [])
    assert s.declines("C-1") == ["note C-1 ended", "end C-1 refused"]


def test_an_analyzer_that_refuses_ends_the_command_and_closes_its_names_until_their_facts_are_suspect():
    s = Harness()
    s.analyzing(script(resources=("RIGHT-ARM", "MODULE")))
    assert s.declines("C-1") == ["note C-1 ended", "end C-1 refused", "timer C-1/4"]
    assert "become suspect" in s.outcome("C-1").message
    assert s.state.resources.quarantine == dict.fromkeys(("RIGHT-ARM", "MODULE"), (WORLD, "C-1"))
    assert s.rings("C-1/4") == ["job C-1/4 analyzer #3 lease MODULE+RIGHT-ARM doubt"]
    assert s.tells("C-1") == []
    assert (s.state.deferred_analyses, s.state.resources.quarantine) == ({}, {})


def test_an_analysis_of_a_motion_that_kills_its_workers_leaves_suspect_facts():
    s = Harness()
    s.analyzing()
    s.loses_worker("C-1")
    s.loses_worker("C-1")
    assert s.loses_worker("C-1") == ["note C-1 ended", "end C-1 failed", "timer C-1/4"]
    assert s.rings("C-1/4") == ["job C-1/4 analyzer #5 lease RIGHT-ARM doubt"]


def test_a_refused_analysis_of_a_stated_fact_changes_no_fact():
    s = Harness()
    s.elaborated(script(resources=("MODULE",)))
    assert s.answers("C-1", stated())[-1] == "note C-1 analyzing"
    assert s.declines("C-1") == ["note C-1 ended", "end C-1 refused"]
    assert s.state.deferred_analyses == {}


def test_a_product_that_is_none_is_a_refusal_and_no_crash():
    s = Harness()
    s.says("X")
    assert s.answers("C-1", {"no": "record"}) == ["note C-1 ended", "end C-1 refused"]
    assert s.outcome("C-1").refusal.reason is RefusalReason.PROGRAM


def test_a_hypothesis_test_reaches_no_subsystem():
    s = Harness()
    s.says("TEST X")
    assert s.answers("C-1", record(test=True)) == ["note C-1 ended", "end C-1 refused"]


def test_both_arms_of_a_control_are_all():
    s = Harness()
    s.executing()
    s.says("ABORT BOTH-ARMS")
    assert "halt C-1 to MCM" in s.answers("C-2", record(kind="control", verb="ABORT", hand="BOTH-ARMS"))
    s.says("HALT BOTH-ARMS")
    assert s.phase("C-1") == "halting"


@pytest.mark.parametrize("verb", ["HALT", "PAUSE", "ABORT"])
def test_the_test_of_a_control_stops_nothing(verb):
    s = Harness()
    s.executing()
    s.says(f"TEST {verb}")
    assert s.answers("C-2", record(test=True, kind="control", verb=verb)) == ["note C-2 ended", "end C-2 refused"]
    assert s.phase("C-1") == "executing"


# --- in the order given ------------------------------------------------------------------------------


def test_what_one_client_gives_is_taken_up_in_the_order_given():
    s = Harness()
    s.says("FIRST")
    s.says("SECOND")
    assert s.answers("C-2", record()) == []  # the parser was quicker with it
    assert s.phase("C-2") == "parsing"
    assert s.answers("C-1", record()) == ["job C-1/2 elaborator #1", "note C-1 elaborating", "note C-2 held"]
    assert s.state.intake_order == {}


def test_the_commands_of_others_do_not_wait():
    s = Harness()
    s.says("FIRST")
    s.says("SECOND", client="bob")
    assert s.answers("C-2", record()) == ["job C-2/2 elaborator #1", "note C-2 elaborating"]


@pytest.mark.parametrize("end", [Harness.declines, lambda s, command: s.halts(command)], ids=["refused", "halted"])
def test_a_sentence_that_ends_unread_lets_the_next_one_go(end):
    s = Harness()
    s.says("FIRST")
    s.says("SECOND")
    s.answers("C-2", record())
    assert end(s, "C-1")[-2:] == ["job C-2/2 elaborator #1", "note C-2 elaborating"]


def test_who_waits_behind_one_that_ends_still_waits_for_the_one_before_that():
    s = Harness()
    for text in ("FIRST", "SECOND", "THIRD"):
        s.says(text)
    s.answers("C-3", record(hand="LEFT-ARM"))
    assert s.declines("C-2") == ["note C-2 ended", "end C-2 refused"]
    assert s.answers("C-1", record())[2:] == ["job C-3/2 elaborator #1", "note C-3 elaborating"]


def test_what_is_parsed_and_waits_for_its_turn_can_be_paused_and_halted():
    s = Harness()
    s.says("FIRST")
    s.says("SECOND")
    s.answers("C-2", record())
    s.parsed(kind="control", verb="PAUSE", object="C-2")
    assert s.state.commands["C-2"].pause_wanted
    assert s.halts("C-2")[-2:] == ["note C-2 ended", "end C-2 halted"]
    assert s.answers("C-1", record()) == ["job C-1/2 elaborator #1", "note C-1 elaborating"]


def test_the_order_given_outlives_the_broker():
    s = Harness()
    s.says("FIRST")
    s.says("SECOND")
    s.answers("C-2", record())
    s.state = wire.decoder(State)(wire.encode(s.state))
    assert s.handle(BrokerRestarted) == ["job C-1/1 parser #2"]
    assert s.answers("C-1", record())[-1] == "note C-2 held"


def test_control_does_not_wait_for_its_turn():
    s = Harness()
    s.says("FIRST")
    s.parsed(kind="control", verb="ABORT", object="C-1")
    assert s.outcome("C-1").kind is OutcomeKind.ABORTED
    assert s.outcome("C-2").kind is OutcomeKind.SUCCEEDED
    assert s.state.intake_order == {}


@pytest.mark.parametrize("verb", ["ABORT", "PAUSE"])
def test_control_of_an_arm_reaches_earlier_sentences_of_its_client_and_not_later_ones(verb):
    s = Harness()
    s.says("MOVE RIGHT-ARM")
    s.says(f"{verb} RIGHT-ARM")
    s.says("MOVE RIGHT-ARM")
    s.answers("C-3", record())
    assert s.answers("C-2", record(kind="control", verb=verb, hand="RIGHT-ARM")) == []
    s.answers("C-1", record())
    assert s.outcome("C-2").message == ("ABORT of C-1" if verb == "ABORT" else "C-1 pauses before its first step")
    assert (s.phase("C-1"), s.phase("C-3")) == (("gone", "elaborating") if verb == "ABORT" else ("elaborating", "held"))
    assert verb == "ABORT" or not s.state.commands["C-3"].pause_wanted


@pytest.mark.parametrize("target", [{"object": "C-1"}, {"hand": "BOTH-ARMS"}, {}])
def test_control_of_all_or_of_a_command_waits_for_no_parser(target):
    s = Harness()
    s.executing()
    s.says("A PARSER HANGS WITH THIS")
    s.parsed(kind="control", verb="ABORT", **target)
    assert s.phase("C-1") == "halting"
    assert s.phase("C-2") == ("parsing" if "object" in target else "gone")


def test_control_of_an_arm_does_not_wait_for_another_client():
    s = Harness()
    s.executing()
    s.says("A PARSER HANGS WITH THIS", client="bob")
    s.parsed(kind="control", verb="ABORT", hand="RIGHT-ARM")
    assert s.phase("C-1") == "halting"


def test_halt_of_an_arm_waits_for_no_parser_whichever_way_it_came():
    s = Harness()
    s.executing()
    s.says("A PARSER HANGS WITH THIS")
    s.parsed("STOP THE RIGHT ONE", kind="control", verb="HALT", hand="RIGHT-ARM")
    assert s.phase("C-1") == "halting"


def test_a_command_that_needs_more_than_it_names_is_not_overtaken():
    s = Harness()
    s.executing(script(resources=("LEFT-ARM",)), hand="LEFT-ARM")
    s.parsed()
    s.parsed()
    assert s.phase("C-3") == "held"
    assert s.answers("C-2", script(resources=("RIGHT-ARM", "LEFT-ARM"))) == ["note C-2 held"]
    s.reports("C-1")
    assert s.answers("C-1", go_on())[-2:] == ["job C-2/3 elaborator #1", "note C-2 elaborating"]
    assert s.phase("C-3") == "held"


# --- lost workers, late and double answers -----------------------------------------------------------


@pytest.mark.parametrize(
    ("reach", "job", "phase"),
    [
        ("says", "C-1/1 parser", "parsing"),
        ("parsed", "C-1/2 elaborator", "elaborating"),
        ("elaborated", "C-1/3 binder", "binding"),
    ],
)
def test_a_lost_job_is_given_out_again(reach, job, phase):
    s = Harness()
    getattr(s, reach)(*["X"] if reach == "says" else [])
    assert s.loses_worker("C-1") == [f"note C-1 {phase}", f"job {job} #2"]


def test_a_lost_analysis_is_done_again_under_the_same_lease():
    s = Harness()
    s.analyzing()
    assert s.loses_worker("C-1") == ["note C-1 analyzing", "job C-1/4 analyzer #2 lease RIGHT-ARM"]


def test_three_deaths_are_poison_and_name_the_evidence():
    s = Harness()
    s.says("X")
    s.loses_worker("C-1")
    s.loses_worker("C-1")
    assert s.loses_worker("C-1") == ["note C-1 ended", "end C-1 refused"]
    assert s.outcome("C-1").refusal.reason is RefusalReason.POISON
    assert s.outcome("C-1").refusal.detail["death 3"] == "worker: exit -9"


def test_a_job_that_only_lay_with_a_dead_worker_is_not_blamed():
    s = Harness()
    s.says("X")
    for _ in range(10):
        s.loses_worker("C-1", blamed=False)
    assert s.phase("C-1") == "parsing"


def test_a_poisoned_analysis_fails_the_command():
    s = Harness()
    s.analyzing()
    for _ in range(3):
        s.loses_worker("C-1")
    assert s.outcome("C-1").kind is OutcomeKind.FAILED


def test_late_and_double_answers_change_nothing():
    s = Harness()
    s.says("X")
    s.loses_worker("C-1")
    assert s.answers("C-1", record(), attempt=1) == []  # the worker thought dead
    s.answers("C-1", record())
    assert s.answers("C-1", record(), job="C-1/1", attempt=2) == []  # the answer twice
    assert s.answers("C-9", record(), job="C-9/1") == []
    assert s.state.counts["stale"] == 3
    assert s.phase("C-1") == "elaborating"


# --- trims -------------------------------------------------------------------------------------------


def test_a_trim_goes_on_the_stack_and_the_step_is_tried_again():
    s = Harness()
    s.analyzing(script(trims=[trim(1)]), StopReason.GOAL)
    assert s.answers("C-1", mend(1)) == ["note C-1 analyzing", "job C-1/5 binder #1", "note C-1 binding"]
    s.answers("C-1", bound("C-1.2"))
    s.reports("C-1")
    s.answers("C-1", go_on())
    assert s.state.commands["C-1"].actions.step == (0, 0)  # the step itself, once more
    assert s.state.commands["C-1"].actions.trim_labels == ["trim 1"]


@pytest.mark.parametrize(
    ("then", "stack"),
    [
        ("retry_step", [(0, 1), (0, 0)]),
        ("restart_script", [(0, 1), (0, 0)]),
        ("skip", [(0, 1)]),
        ("replace_rest", []),
        ("give_up", []),
    ],
)
def test_what_follows_a_trim(then, stack):
    s = Harness()
    s.analyzing(script(steps=2, trims=[trim(1, then)]))
    s.answers("C-1", mend(1))
    assert s.state.commands["C-1"].actions.step == (1, 0)
    assert s.state.commands["C-1"].actions.refs == stack


def test_a_trim_is_used_once_for_a_step():
    s = Harness()
    s.analyzing(script(trims=[trim(1, steps=0)]))
    s.answers("C-1", mend(1))
    s.answers("C-1", bound("C-1.2"))
    s.reports("C-1")
    assert s.answers("C-1", mend(1)) == ["note C-1 ended", "end C-1 failed"]


def test_a_command_that_gives_up_first_does_what_it_has_to_and_then_fails_of_its_cause():
    s = Harness()
    s.analyzing(script(steps=2, trims=[trim(1, "give_up", steps=2)]))
    s.answers("C-1", mend(1))
    for n in (2, 3):
        s.answers("C-1", bound(f"C-1.{n}"))
        s.reports("C-1")
        last = s.answers("C-1", go_on())
    assert last[-1] == "end C-1 failed"
    assert s.outcome("C-1").stop is StopReason.NO_CONTACT


@pytest.mark.parametrize("bound_first", [True, False])
def test_the_first_failure_is_the_cause_of_what_follows_it(bound_first):
    s = Harness()
    s.analyzing(script(trims=[trim(1, "give_up")]))
    s.answers("C-1", mend(1))
    if bound_first:
        s.answers("C-1", bound("C-1.2"))
        s.reports("C-1")
        s.answers("C-1", give_up())
    else:
        s.declines("C-1")
    outcome = s.outcome("C-1")
    assert outcome.kind is OutcomeKind.FAILED
    assert outcome.stop is StopReason.NO_CONTACT
    assert "after that" in outcome.message


def test_giving_up_reports_the_failure():
    s = Harness()
    s.analyzing()
    assert s.answers("C-1", give_up()) == ["note C-1 ended", "end C-1 failed"]
    assert s.outcome("C-1").stop is StopReason.FORCE_LIMIT
    assert s.outcome("C-1").message == "too much force"
    assert s.outcome("C-1").step == "1 of 1: step 1"


# --- resources ---------------------------------------------------------------------------------------


def test_disjoint_arms_execute_at_once():
    s = Harness()
    s.executing()
    s.executing(script(resources=("LEFT-ARM",)), hand="LEFT-ARM")
    assert [s.phase(c) for c in ("C-1", "C-2")] == ["executing", "executing"]


def test_a_busy_arm_holds_the_command_until_it_is_free_and_then_plans_anew():
    s = Harness()
    s.executing()
    s.says("X")
    assert s.answers("C-2", record()) == ["note C-2 held"]
    s.reports("C-1")
    assert s.answers("C-1", go_on()) == [
        "note C-1 analyzing",
        "note C-1 ended",
        "end C-1 succeeded",
        "job C-2/2 elaborator #1",
        "note C-2 elaborating",
    ]


def test_what_only_the_script_needs_is_waited_for_too():
    s = Harness()
    s.executing(script(resources=("RIGHT-ARM", "MODULE")))
    s.parsed(hand="LEFT-ARM")
    assert s.answers("C-2", script(resources=("LEFT-ARM", "MODULE"))) == ["note C-2 held"]
    assert "C-2" not in s.state.resources.held  # it waits with empty hands


def test_now_is_refused_with_the_owner():
    s = Harness()
    s.executing()
    s.says("X NOW")
    assert s.answers("C-2", record(now=True)) == ["note C-2 ended", "end C-2 refused"]
    assert s.outcome("C-2").refusal.reason is RefusalReason.RESOURCE
    assert s.outcome("C-2").refusal.owner == "C-1"


def test_a_held_command_can_be_stopped():
    s = Harness()
    s.executing()
    s.parsed()
    assert s.halts("C-2") == ["note C-2 ended", "end C-2 halted"]


# --- halt --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reach", ["says", "parsed", "elaborated"])
def test_halt_of_a_command_that_moves_nothing_ends_it_at_once(reach):
    s = Harness()
    getattr(s, reach)(*["X"] if reach == "says" else [])
    job = s.state.commands["C-1"].job.id
    assert s.halts() == ["halt ALL to MCM", f"cancel {job}", "note C-1 ended", "end C-1 halted"]
    assert s.answers("C-1", record(), job=job) == []  # the answer under way is stale


def test_halt_of_a_motion_waits_for_rest_and_puts_the_world_right():
    s = Harness()
    s.executing()
    assert s.halts() == ["halt ALL to MCM", "halt C-1 to MCM", "timer C-1", "note C-1 halting"]
    assert s.reports("C-1", StopReason.HALT) == [
        "no timer C-1",
        "ack C-1.1",
        "no timer C-1",
        "job C-1/4 analyzer #1 lease RIGHT-ARM",
        "timer C-1",
        "note C-1 closing",
    ]
    assert s.answers("C-1", go_on()) == ["no timer C-1", "note C-1 ended", "end C-1 halted"]
    assert s.state.resources.held == {}


def test_halt_at_the_subsystem_itself_is_understood():
    s = Harness()
    s.executing()
    s.reports("C-1", StopReason.HALT)  # a halt by the emergency stop, past the broker
    assert s.phase("C-1") == "closing"
    assert s.answers("C-1", go_on())[-1] == "end C-1 halted"


def test_an_analysis_under_way_is_let_finish_and_its_advice_ignored():
    s = Harness()
    s.analyzing(script(steps=2))
    assert s.halts() == ["halt ALL to MCM", "timer C-1", "note C-1 closing"]
    assert s.answers("C-1", go_on()) == ["no timer C-1", "note C-1 ended", "end C-1 halted"]


def test_stated_facts_are_written_although_the_command_is_halted():
    s = Harness()
    s.elaborated(script(steps=2, resources=("MODULE",)))
    s.answers("C-1", stated())
    assert s.halts() == ["halt ALL to MCM", "timer C-1", "note C-1 closing"]
    assert s.answers("C-1", go_on()) == ["no timer C-1", "note C-1 ended", "end C-1 halted"]


def test_rest_without_confirmation_is_distinguished_and_closes_the_arm():
    s = Harness()
    s.executing()
    s.halts()
    assert s.rings("C-1") == [
        "no timer C-1",
        "job C-1/4 analyzer #1 lease RIGHT-ARM",
        "timer C-1",
        "note C-1 closing",
    ]
    stated = wire.decoder(AnalyzerInput)(s.state.commands["C-1"].job.input)
    assert (stated.report.joints, stated.closing) == ([], True)  # the position is unknown, and the world records that
    assert s.answers("C-1", go_on()) == ["no timer C-1", "note C-1 ended", "end C-1 halt_not_confirmed"]
    assert s.state.resources.quarantine == {"RIGHT-ARM": ("MCM", "C-1.1")}
    s.parsed()
    assert s.phase("C-2") == "held"
    assert s.rests("h1") == ["job C-2/2 elaborator #1", "note C-2 elaborating"]


def test_halt_all_starts_nothing_that_was_in_line():
    s = Harness()
    s.executing()
    s.parsed()
    s.parsed()
    effects = s.halts()
    assert [e for e in effects if e.startswith(("job", "primitive"))] == []
    assert [s.phase(c) for c in ("C-1", "C-2", "C-3")] == ["halting", "gone", "gone"]
    s.reports("C-1", StopReason.HALT)
    s.answers("C-1", go_on())
    s.executing()
    assert s.phase("C-4") == "executing"  # and a new one works at once


def test_a_sentence_sent_before_halt_all_does_not_start_after_it():
    s = Harness()
    s.now = 10.0
    s.halts()
    assert s.says("X", sent_at_s=9.0) == ["tell ann Accepted C-1", "note C-1 ended", "end C-1 halted"]
    assert s.says("X", sent_at_s=10.5)[1] == "job C-2/1 parser #1"


@pytest.mark.parametrize(
    ("received_at_s", "sent_at_s", "halted"),
    [
        (10.0, 10.5, False),  # sent after the halt had been obeyed
        (10.0, 9.5, True),
        (10.0, 0.0, True),  # when it was sent is unknown
        (10.0, 99.0, True),  # a clock in the future proves nothing
        (0.0, 10.5, True),  # when it was received is unknown
    ],
)
def test_a_halt_that_a_subsystem_forwards_late_spares_what_was_sent_later(received_at_s, sent_at_s, halted):
    s = Harness()
    s.now = 11.0
    s.says("X", sent_at_s=sent_at_s)
    s.now = 12.0
    s.handle(HaltCalled, client="MCM", halt="h1", scope="ALL", called_at_s=9.0, received_at_s=received_at_s)
    assert s.phase("C-1") == ("gone" if halted else "parsing")


def test_halt_of_one_arm_leaves_the_other():
    s = Harness()
    s.executing()
    s.executing(script(resources=("LEFT-ARM",)), hand="LEFT-ARM")
    assert s.halts("LEFT-ARM") == ["halt LEFT-ARM to MCM", "halt C-2 to MCM", "timer C-2", "note C-2 halting"]
    assert s.phase("C-1") == "executing"


def test_halt_of_an_ended_command_is_no_mistake():
    s = Harness()
    s.says("X")
    s.declines("C-1")
    assert s.halts("C-1") == []  # the MCM confirms that nothing of it moves
    assert s.halts("C-2", "h2") == ["decline halt h2"]
    assert s.says("HALT C-1")[-1] == "end C-2 succeeded"


def test_halt_of_nothing_known_is_declined():
    assert Harness().halts("C-9") == ["decline halt h1"]


def test_halt_on_an_idle_system_still_reaches_the_subsystem():
    assert Harness().halts() == ["halt ALL to MCM"]


@pytest.mark.parametrize("caller", ["ann", "bob", "MCM"])
def test_a_halt_whose_name_was_used_before_stops_what_is_in_scope_now(caller):
    """Two callers may count their halts from one; a button may always say the same."""
    s = Harness()
    s.halts("LEFT-ARM", "1")
    s.executing()
    assert s.handle(HaltCalled, client=caller, halt="1", scope="ALL")[:2] == ["halt ALL to MCM", "halt C-1 to MCM"]
    s.reports("C-1", StopReason.HALT)
    s.answers("C-1", go_on())
    s.executing()
    assert s.handle(HaltCalled, client=caller, halt="1", scope="ALL")[:2] == ["halt ALL to MCM", "halt C-2 to MCM"]


def test_a_halt_by_both_endpoints_is_counted_once_and_a_new_command_works():
    s = Harness()
    s.halts()
    s.handle(HaltCalled, client="MCM", halt="h1", scope="ALL")
    assert s.state.counts["halts"] == 1
    assert s.phase(s.executing()) == "executing"


def test_a_halt_is_published_once_to_listeners_also_one_that_halts_nothing():
    s = Harness()
    assert not any(line.startswith("publish") for line in s.halts("ALL", "h0"))
    s.handle(ListenersChanged, listening=True)
    assert "publish halt h1 ALL" in s.handle(HaltCalled, client="ann", halt="h1", scope="ALL", called_at_s=9.0)
    assert not any(
        line.startswith("publish")
        for line in s.handle(HaltCalled, client="MCM", halt="h1", scope="ALL", called_at_s=9.0)
    )
    s.handle(HaltCalled, client="ann", halt="h2", scope="NO-ARM")
    published = [e.halt for e in s.log if isinstance(e, PublishHalt)]
    assert [(halt.halt, "NO-ARM" in halt.refused) for halt in published] == [("h1", False), ("h2", True)]


def test_a_halt_is_answered_under_the_number_it_came_with():
    s = Harness()
    s.handle(HaltCalled, client="ann", halt="1", scope="ALL", call="7-1")
    s.handle(HaltCalled, client="MCM", halt="1", scope="ALL", call="4-9")
    assert [e.call for e in s.log if isinstance(e, SendHalt)] == ["7-1", "4-9"]


def test_halt_typed_as_a_sentence_ends_when_rest_is_confirmed():
    s = Harness()
    s.executing()
    assert s.says("halt all.") == [
        "tell ann Accepted C-2",
        "note C-2 halting",
        "timer C-2",
        "halt ALL to MCM",
        "halt C-1 to MCM",
        "timer C-1",
        "note C-1 halting",
    ]
    assert s.rests("C-2") == ["no timer C-2", "note C-2 ended", "end C-2 succeeded"]


def test_halt_typed_and_not_confirmed():
    s = Harness()
    s.says("HALT")
    assert s.rests("C-1", at_rest=False)[-1] == "end C-1 halt_not_confirmed"


def test_halt_typed_ends_when_all_that_got_it_have_confirmed():
    s = Harness()
    s.handle(SubsystemConnected, subsystem="CAM", pid=2, performers=["CAMERA"])
    s.executing()
    s.says("HALT ALL")
    cam = {"subsystem": "CAM", "halt": "C-2", "at_rest": True}
    assert s.handle(HaltConfirmed, **cam) == []  # C-1 still moves
    assert s.handle(HaltConfirmed, **cam) == []
    assert (s.phase("C-1"), s.phase("C-2")) == ("halting", "halting")
    assert s.rests("C-2")[-1] == "end C-2 succeeded"


def test_halt_typed_names_who_has_not_confirmed():
    s = Harness()
    s.handle(SubsystemConnected, subsystem="CAM", pid=2, performers=["CAMERA"])
    s.says("HALT ALL")
    s.handle(HaltConfirmed, subsystem="CAM", halt="C-1", at_rest=True)
    assert s.rings("C-1")[-1] == "end C-1 halt_not_confirmed"
    assert "rest was not confirmed by MCM" in s.outcome("C-1").message


def test_halt_of_an_arm_stops_what_names_it_alone_or_with_the_other_and_nothing_else():
    s = Harness()
    s.elaborated()
    s.parsed(hand="LEFT-ARM", after="C-1")
    s.parsed(hand="BOTH-ARMS")
    s.parsed(hand="RIGHT-ARM", to_hand="LEFT-ARM")
    s.parsed(hand="RIGHT-ARM")
    s.halts("LEFT-ARM")
    assert list(s.state.commands) == ["C-1", "C-5"]


# --- abort, pause, resume ----------------------------------------------------------------------------


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
    assert outcome.message == message
    assert outcome.kind is (OutcomeKind.REFUSED if "not" in message else OutcomeKind.SUCCEEDED)


def test_a_pause_in_the_last_step_is_refused():
    s = Harness()
    s.executing(script(steps=1))
    outcome = s.outcome(s.parsed(kind="control", verb="PAUSE", object="C-1"))
    assert outcome.refusal is not None
    assert outcome.message == "C-1 is in its last step (1 of 1: step 1) and ends with it"
    assert outcome.refusal.clears == "HALT C-1 stops now, and ends it"


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
    assert s.outcome("C-2").message == "C-1 slows down on its path and pauses, in step 1 of 1: step 1"
    s.handle(PrimitivePaced, subsystem="MCM", primitive="C-1.1", paused=True, done=0.4)
    assert s.state.commands["C-1"].notes[-1].note == "stands on its path, 40% done"
    s.says("RESUME C-1")
    answers = s.answers("C-3", record(kind="control", verb="RESUME", object="C-1"))
    assert answers[2:] == ["timer C-1", "go on C-1.1 at MCM"]
    s.reports("C-1")
    assert s.answers("C-1", go_on())[-1] == "end C-1 succeeded"


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


# --- after, together with ----------------------------------------------------------------------------


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


def test_after_last_of_one_that_has_failed_is_refused():
    s = Harness()
    s.analyzing()
    s.answers("C-1", give_up())
    s.parsed(after="LAST")
    assert s.outcome("C-2").refusal.message == "C-1 has ended without success"


def test_after_last_without_one_before_is_refused():
    s = Harness()
    s.says("X", client="bob")
    s.parsed(after="LAST")

    refusal = s.outcome("C-2").refusal
    assert (refusal.reason, refusal.where) == (RefusalReason.NAME, "LAST")
    assert "AFTER C-n" in refusal.clears


def test_the_latest_commands_of_many_clients_are_bounded():
    s = Harness()
    for n in range(CLIENTS_KEPT + 5):
        s.says("HALT", client=f"client-{n}")
    assert len(s.state.last_given) == CLIENTS_KEPT


# --- words ---------------------------------------------------------------------------------------------


def test_a_lost_subsystem_says_what_leads_on():
    s = Harness()
    s.executing()
    s.mcm_gone()
    s.answers("C-1", go_on())
    assert (s.outcome("C-1").kind, s.outcome("C-1").refusal.clears) == (
        OutcomeKind.LOST_SUBSYSTEM,
        stopping.RETRY_ADVICE,
    )


def test_a_step_of_a_trim_has_its_own_words():
    s = Harness()
    s.analyzing(script(trims=[trim()]))
    s.answers("C-1", mend())
    assert s.state.commands["C-1"].step_words == "trim 1, 1 of 1: mend"


def test_a_control_word_that_finds_nothing_says_so():
    s = Harness()
    s.parsed(kind="control", verb="ABORT", object="ALL")
    assert s.outcome("C-1").message == "ABORT had nothing to act on"


@pytest.mark.parametrize("verb", ["PAUSE", "RESUME", "ABORT"])
def test_an_idle_arm_is_nothing_to_act_on_and_an_unknown_name_is_refused(verb):
    s = Harness()
    s.parsed(kind="control", verb=verb, hand="RIGHT-ARM")
    s.parsed(kind="control", verb=verb, object="NOWHERE")
    assert (s.outcome("C-1").kind, s.outcome("C-1").message) == ("succeeded", f"{verb} had nothing to act on")
    assert s.outcome("C-2").refusal.reason == "name"


# --- report, and how long a step takes ---------------------------------------------------------------


def test_what_was_measured_is_in_the_outcome_and_in_the_note_as_far_as_it_was_asked_for():
    s = Harness()
    s.executing(report=Report(pose=True, forces=True))
    s.reports("C-1")
    s.answers("C-1", go_on())

    measured = s.outcome("C-1").measured
    assert (measured.arm, measured.tcp_pose, measured.wrench) == ("RIGHT-ARM", [0, 0, 0, 0, 0, 0, 1], [0.0] * 6)
    assert measured.joints is None
    assert [e.note.measured for e in s.log if isinstance(e, do.PublishNote) and e.note.measured] == [measured]


def test_a_halted_command_reports_what_was_measured_too():
    s = Harness()
    s.executing(report=Report(joints=True))
    s.halts("C-1")
    s.reports("C-1", StopReason.HALT)
    s.answers("C-1", go_on())
    assert s.outcome("C-1").measured.joints == [0.0] * 6


def test_without_report_nothing_is_added():
    s = Harness()
    s.analyzing()
    s.answers("C-1", go_on())
    assert s.outcome("C-1").measured is None


def test_periodic_reports_without_a_receiver_are_refused():
    s = Harness()
    s.says("X", progress=False)
    s.answers("C-1", record(report=Report(every_s=0.5)))
    assert s.outcome("C-1").refusal.where == "EVERY"


def test_a_step_says_how_long_it_takes():
    s = Harness()
    s.state.timeout_scale = 2.0
    s.elaborated()
    s.answers("C-1", msgspec.structs.replace(bound("C-1.1"), predicted_s=4.2))
    assert s.state.commands["C-1"].notes[-1].expected_s == 8.4


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


# --- subsystems --------------------------------------------------------------------------------------


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


# --- the world away ----------------------------------------------------------------------------------


def away(s, command="C-1"):
    return s.declines(command, RefusalReason.TIMEOUT)


@pytest.mark.parametrize("reach", ["says", "parsed", "elaborated"])
def test_before_anything_has_moved_a_world_that_is_away_is_a_refusal(reach):
    s = Harness()
    getattr(s, reach)(*["X"] if reach == "says" else [])
    assert away(s) == ["note C-1 ended", "end C-1 refused"]
    assert s.outcome("C-1").refusal.reason is RefusalReason.TIMEOUT


def test_between_two_steps_it_is_a_failure():
    s = Harness()
    s.analyzing(script(steps=2))
    s.answers("C-1", go_on())
    assert away(s) == ["note C-1 ended", "end C-1 failed"]
    assert s.state.deferred_analyses == {}  # the step before is written


def test_an_analysis_that_the_world_did_not_get_is_repeated_without_blame():
    s = Harness()
    s.analyzing(script(steps=2))
    for attempt in range(1, 11):  # six seconds each
        s.now += 5.0
        assert away(s) == ["timer C-1", "note C-1 analyzing"]
        assert s.answers("C-1", go_on(), attempt=attempt) == []  # late
        assert s.rings("C-1") == [f"job C-1/4 analyzer #{attempt + 1} lease RIGHT-ARM"]
    assert s.state.commands["C-1"].job.deaths == []
    assert s.answers("C-1", go_on()) == ["note C-1 analyzing", "job C-1/5 binder #1", "note C-1 binding"]


def test_after_a_minute_the_command_fails_and_what_it_touched_is_closed_until_the_world_is_written():
    s = Harness()
    s.analyzing(script(resources=("RIGHT-ARM", "MODULE")))
    s.now += 61.0
    assert away(s) == ["note C-1 ended", "end C-1 failed", "timer C-1/4"]
    assert s.outcome("C-1").refusal.reason is RefusalReason.TIMEOUT
    assert s.outcome("C-1").refusal.message.endswith("stay quarantined until the world database is updated")
    assert s.state.resources.quarantine == dict.fromkeys(("RIGHT-ARM", "MODULE"), (WORLD, "C-1"))
    s.parsed()
    assert s.state.commands["C-2"].notes[-1].note == (
        "RIGHT-ARM is in use by the world database, which does not have the changes of C-1 yet"
    )
    s.halts("RIGHT-ARM")
    s.rests("h1")  # rest is not a fact for the world
    assert set(s.state.resources.quarantine) == {"RIGHT-ARM", "MODULE"}
    assert s.handle(TimerFired, timer="C-1/4") == ["job C-1/4 analyzer #3 lease RIGHT-ARM+MODULE"]
    assert s.tells("C-1", "away") == ["timer C-1/4"]
    assert s.handle(TimerFired, timer="C-1/4") == ["job C-1/4 analyzer #5 lease RIGHT-ARM+MODULE"]
    s.state = wire.decoder(State)(wire.encode(s.state))
    assert s.handle(BrokerRestarted) == ["job C-1/4 analyzer #6 lease RIGHT-ARM+MODULE"]
    assert s.tells("C-1") == []
    assert s.state.resources.quarantine == {}
    assert s.parsed() == "C-3"
    assert s.phase("C-3") == "elaborating"


def test_a_command_stopped_while_it_waits_for_the_world_ends_soon_and_the_world_is_written_later():
    s = Harness()
    s.analyzing()
    away(s)
    assert s.halts() == ["halt ALL to MCM", "job C-1/4 analyzer #2 lease RIGHT-ARM", "timer C-1", "note C-1 closing"]
    assert away(s) == ["no timer C-1", "note C-1 ended", "end C-1 halted", "timer C-1/4"]
    assert s.state.resources.quarantine == {"RIGHT-ARM": (WORLD, "C-1")}


def test_an_arm_neither_at_rest_nor_analysed_is_closed_until_both_are():
    s = Harness()
    s.executing()
    s.mcm_gone()
    away(s)
    assert s.state.resources.quarantine == {"RIGHT-ARM": ("MCM", "C-1.1")}
    s.mcm_hello(pid=2)
    assert s.state.resources.quarantine == {"RIGHT-ARM": (WORLD, "C-1")}
    s.handle(TimerFired, timer="C-1/4")
    s.tells("C-1")
    assert s.state.resources.quarantine == {}


def test_an_analysis_left_that_kills_its_workers_is_given_up():
    s = Harness()
    s.executing()
    s.mcm_gone()
    s.rings("C-1")
    s.mcm_hello(pid=2)
    for deaths in (1, 2):
        assert s.tells("C-1", "dies") == [f"job C-1/4 analyzer #{deaths + 1} lease RIGHT-ARM"]
    for attempt in (5, 7):
        assert s.tells("C-1", "dies") == ["timer C-1/4"]
        assert s.rings("C-1/4") == [f"job C-1/4 analyzer #{attempt} lease RIGHT-ARM doubt"]
        assert s.state.resources.quarantine == {"RIGHT-ARM": (WORLD, "C-1")}
    assert s.tells("C-1") == []
    assert (s.state.deferred_analyses, s.state.resources.quarantine) == ({}, {})
    assert s.state.counts["analyses_given_up"] == 1


def test_a_restarted_broker_asks_the_world_at_once():
    s = Harness()
    s.analyzing()
    away(s)
    assert s.handle(BrokerRestarted) == ["job C-1/4 analyzer #3 lease RIGHT-ARM"]
    assert s.rings("C-1") == []


def test_a_repeated_report_is_acknowledged_twice_and_handled_once():
    s = Harness()
    s.analyzing()
    assert s.reports("C-1", primitive="C-1.1") == ["ack C-1.1"]


# --- clients -----------------------------------------------------------------------------------------


def test_a_repeated_sentence_is_one_command():
    s = Harness()
    s.says("X", request="r1")
    assert s.says("X", request="r1") == ["tell ann Accepted C-1"]
    assert s.says("X", client="bob", request="r1")[0] == "tell bob Accepted C-2"


def test_the_rest_of_a_halt_that_its_caller_named_like_a_command_is_not_the_rest_of_that_command():
    s = Harness()
    s.executing()
    s.halts("C-1", halt="h1")
    s.rests("C-1")
    assert s.phase("C-1") == "halting"
    s.rests("stop-C-1")
    assert s.phase("C-1") == "closing"


def test_a_result_is_kept_for_a_client_that_asks_again():
    s = Harness()
    s.says("X", request="r1")
    s.declines("C-1")
    assert s.says("X", request="r1") == ["tell ann Accepted C-1", "tell ann CommandEnded"]


def test_a_client_that_goes_away_halts_only_what_it_wanted_halted():
    s = Harness()
    s.says("X")
    s.says("X", halt_if_lost=True)
    s.handle(ClientGone, client="ann")
    assert [s.phase(c) for c in ("C-1", "C-2")] == ["parsing", "gone"]


# --- programs ----------------------------------------------------------------------------------------


def test_a_new_program_whose_first_job_fails_is_rolled_back():
    s = Harness()
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="old")
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="new")
    s.says("X")
    assert s.state.commands["C-1"].job.program == "new"
    assert s.loses_worker("C-1") == ["note C-1 parsing", "job C-1/1 parser #2"]
    assert s.state.commands["C-1"].job.program == "old"
    assert s.state.programs["parser"] == "old"
    stated, warning = s.state.commands["C-1"].notes[-1].note, s.state.commands["C-1"].notes[-1].warning
    assert warning
    assert stated.startswith("the new parser program new failed its first job (")
    assert s.state.rollouts["parser"].why == f"{stated}. The job was of C-1"
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="newer")
    assert not s.state.rollouts["parser"].why


@pytest.mark.parametrize("fail", [Harness.loses_worker, lambda s, c: s.declines(c, RefusalReason.PROGRAM)])
def test_what_else_was_under_way_with_a_program_that_was_rolled_back_is_done_again_with_the_old_one(fail):
    s = Harness()
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="old")
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="new")
    s.says("X")
    s.says("Y")
    fail(s, "C-1")
    assert fail(s, "C-2") == ["note C-2 parsing", "job C-2/1 parser #2"]
    assert s.state.commands["C-2"].job.program == "old"
    assert s.state.commands["C-2"].job.deaths == []
    assert "C-1" in s.state.rollouts["parser"].why  # it names the first
    assert fail(s, "C-2")[0] == ("note C-2 parsing" if fail is Harness.loses_worker else "note C-2 ended")
    assert s.state.counts["programs_rolled_back"] == 1


def test_the_file_of_a_program_is_known_and_after_a_roll_back_that_of_the_one_before():
    s = Harness()
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="old", file="good.lark")
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="new", file="bad.lark")
    s.says("X")
    assert s.state.program_files[s.state.programs["parser"]][0] == "bad.lark"
    s.loses_worker("C-1")
    assert s.state.program_files[s.state.programs["parser"]][0] == "good.lark"
    for n in range(100):
        s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest=f"p{n}", file="many.lark")
    assert len(s.state.program_files) == 64


def test_back_from_a_new_program_is_to_one_that_has_done_a_job():
    s = Harness()
    for digest in ("old", "new", "newer"):
        s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest=digest)
    s.says("X")
    s.loses_worker("C-1")
    assert s.state.programs["parser"] == "old"
    for digest in ("new", "old"):
        s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest=digest)
    assert s.state.rollouts["parser"].phase is RolloutPhase.PROVEN


def test_back_is_to_the_last_program_that_has_worked_though_it_was_left_meanwhile():
    s = Harness()
    for digest in ("default", "good", "other"):
        s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest=digest)
        s.parsed()  # each does a job well
    for digest in ("good", "bad"):
        s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest=digest)
    s.says("X")
    s.loses_worker("C-4")
    assert s.state.programs["parser"] == "good"


def test_a_new_program_whose_first_job_is_done_stays():
    s = Harness()
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="old")
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="new")
    s.parsed()
    s.says("X")
    s.loses_worker("C-2")
    assert s.state.programs["parser"] == "new"


def install(s, digest, *kinds):
    for kind in kinds or WorkerKind:
        s.handle(ProgramInstalled, kind=kind, digest=digest)


def test_a_running_command_keeps_the_programs_it_began_with():
    s = Harness()
    install(s, "old")
    s.says("X")
    install(s, "new")
    s.says("Y")
    assert s.state.commands["C-2"].job.program == "new"
    used = [s.state.commands["C-1"].job]
    s.answers("C-1", record())
    used.append(s.state.commands["C-1"].job)
    s.answers("C-1", script())
    used.append(s.state.commands["C-1"].job)
    s.answers("C-1", bound("C-1.1"))
    s.reports("C-1")
    used.append(s.state.commands["C-1"].job)
    assert [(job.kind, job.program) for job in used] == [(kind, "old") for kind in WorkerKind]


def test_a_failure_with_a_program_that_had_worked_is_not_tried_with_the_one_loaded_meanwhile():
    s = Harness()
    install(s, "old")
    s.says("X")
    install(s, "new")
    assert s.declines("C-1", RefusalReason.PROGRAM)[0] == "note C-1 ended"
    assert s.state.programs["parser"] == "new"


def test_a_roll_back_reaches_the_live_commands_that_began_with_the_program():
    s = Harness()
    install(s, "old")
    install(s, "new", WorkerKind.PARSER)
    s.says("X")
    s.says("Y")
    s.loses_worker("C-1")
    assert [s.state.commands[c].programs["parser"] for c in ("C-1", "C-2")] == ["old", "old"]
    install(s, "newer", WorkerKind.PARSER)
    s.loses_worker("C-2")
    assert s.state.commands["C-2"].job.program == "old"


# --- restart -----------------------------------------------------------------------------------------


def test_a_restarted_broker_assigns_again_what_was_assigned():
    s = Harness()
    s.says("X", client="bob")
    s.executing(hand="LEFT-ARM")
    s.state = wire.decoder(State)(wire.encode(s.state))  # as through a snapshot
    assert s.handle(BrokerRestarted) == ["job C-1/1 parser #2", "timer C-2"]
    assert s.mcm_hello(outstanding=["C-2.1"]) == []  # it has gone on meanwhile
    assert s.reports("C-2")[2] == "job C-2/4 analyzer #1 lease RIGHT-ARM"


def test_a_primitive_that_never_arrived_is_sent_again_after_a_restart():
    s = Harness()
    s.executing()
    s.handle(BrokerRestarted)
    assert s.mcm_hello(outstanding=[]) == ["primitive C-1.1 to MCM", "timer C-1"]


def test_a_primitive_bound_before_the_subsystem_reconnects_waits_for_it():
    s = Harness()
    s.elaborated()
    s.handle(BrokerRestarted)
    assert s.answers("C-1", bound("C-1.1")) == ["timer C-1", "note C-1 executing"]
    assert s.mcm_hello()[0] == "primitive C-1.1 to MCM"


def test_a_halt_lost_with_the_broker_is_ordered_again():
    s = Harness()
    s.executing()
    s.halts()
    s.handle(BrokerRestarted)
    assert s.mcm_hello(outstanding=["C-1.1"]) == ["halt C-1 to MCM", "timer C-1"]


# --- what exploring all interleavings found (tests/simulation) ---------------------------------------


def reported_by_mcm(s: Harness, scope: str = "ALL", halt: str = "h1") -> list[str]:
    return s.handle(HaltCalled, client="MCM", halt=halt, scope=scope)


def test_a_halt_that_only_the_subsystem_received_stops_everything_here_too():
    s = Harness()
    s.parsed()
    assert reported_by_mcm(s) == ["halt ALL to MCM", "cancel C-1/2", "note C-1 ended", "end C-1 halted"]


def test_a_subsystem_that_tells_of_a_halt_is_always_answered_with_it_or_it_would_begin_nothing_for_ever():
    s = Harness()
    s.halts()
    assert reported_by_mcm(s) == ["halt ALL to MCM"]  # known already
    assert reported_by_mcm(s, "C-9", "h2") == ["halt C-9 to MCM"]  # means nothing here


def test_a_primitive_is_meant_for_the_process_that_sent_hello():
    s = Harness()
    s.mcm_hello(pid=7)
    s.executing()
    assert next(e.pid for e in s.log if isinstance(e, SendPrimitive)) == 7


def test_rest_of_one_arm_says_nothing_about_the_other():
    s = Harness()
    s.executing()
    s.halts("C-1")
    s.rings("C-1")
    s.answers("C-1", go_on())
    s.handle(HaltConfirmed, subsystem="MCM", halt="h2", at_rest=True, performers=["LEFT-ARM"])
    assert s.state.resources.quarantine == {"RIGHT-ARM": ("MCM", "C-1.1")}
    s.handle(HaltConfirmed, subsystem="MCM", halt="h3", at_rest=True, performers=["RIGHT-ARM"])
    assert s.state.resources.quarantine == {}


@pytest.mark.parametrize("late", ["the report", "the confirmation"])
def test_a_late_word_on_what_was_stopped_opens_its_arm(late):
    s = Harness()
    s.executing()
    s.halts()
    s.rings("C-1")
    s.answers("C-1", go_on())
    s.reports("C-9", primitive="C-9.4")
    s.reports("C-1", primitive="C-1.0")  # of an earlier step, repeated
    assert s.state.resources.quarantine == {"RIGHT-ARM": ("MCM", "C-1.1")}
    if late == "the report":
        s.reports("C-1", StopReason.HALT, primitive="C-1.1")
    else:  # the scope of the halt is the command: when it moved nothing, no arm is named
        s.handle(HaltConfirmed, subsystem="MCM", halt="stop-C-1", at_rest=True, performers=[])
    assert s.state.resources.quarantine == {}


def test_rest_without_a_report_means_that_the_primitive_never_began():
    s = Harness()
    s.executing()  # the broker died before the primitive was out, and now knows of a halt
    s.halts()
    assert s.rests("stop-C-1") == [
        "no timer C-1",
        "job C-1/4 analyzer #1 lease RIGHT-ARM",
        "timer C-1",
        "note C-1 closing",
    ]
    assert s.answers("C-1", go_on())[-1] == "end C-1 halted"


def test_what_is_being_analysed_moves_nothing_and_its_arm_stays_open_when_the_subsystem_is_lost():
    s = Harness()
    s.analyzing()
    s.mcm_gone()
    assert s.answers("C-1", go_on())[-1] == "end C-1 lost_subsystem"
    assert s.state.resources.quarantine == {}


@pytest.mark.parametrize("at_rest", [True, False])
def test_what_a_new_process_says_of_rest_holds_for_what_the_old_one_moved(at_rest):
    s = Harness()
    s.executing()
    s.mcm_hello(pid=2, at_rest=at_rest)
    s.mcm_gone()
    assert s.answers("C-1", go_on())[-1] == "end C-1 lost_subsystem"
    assert s.state.resources.quarantine == ({} if at_rest else {"RIGHT-ARM": ("MCM", "C-1.1")})


def test_an_unacknowledged_report_of_an_earlier_step_does_not_stop_the_step_that_moves():
    s = Harness()
    s.analyzing(script(steps=2))
    s.answers("C-1", go_on())
    s.answers("C-1", bound("C-1.2"))
    assert s.mcm_hello(outstanding=["C-1.2", "C-1.1"], at_rest=False) == []


def test_a_subsystem_that_comes_back_moving_is_halted_anew_each_time():
    s = Harness()
    for _ in range(2):
        s.mcm_gone()
        assert s.mcm_hello(at_rest=False) == ["halt ALL to MCM"]
    first, second = (e.halt for e in s.log if isinstance(e, SendHalt))
    assert first != second


def test_a_timer_that_rings_in_the_turn_that_sets_it_anew_is_late():
    s = Harness()
    s.executing()
    rung_s = s.state.commands["C-1"].due_s
    s.now = rung_s - 0.0005
    s.halts()
    assert s.handle(TimerFired, timer="C-1") == []
    assert s.phase("C-1") == "halting"


def test_of_two_halts_the_later_counts_in_whatever_order_they_arrive():
    s = Harness()
    s.now = 10.0
    s.handle(HaltCalled, client="ann", halt="h2", scope="ALL", called_at_s=9.0)
    s.handle(HaltCalled, client="ann", halt="h1", scope="ALL", called_at_s=7.0)
    assert s.says("X", sent_at_s=8.0)[-1] == "end C-1 halted"


def test_a_sentence_sent_before_the_halt_of_an_arm_and_received_after_it_does_not_move_that_arm():
    s = Harness()
    s.now = 10.0
    s.halts("RIGHT-ARM")
    s.says("X", sent_at_s=9.0)  # it was long under way: the broker was dead
    s.answers("C-1", record(hand=None))
    assert s.answers("C-1", script())[-1] == "end C-1 halted"


def test_a_halt_of_a_command_that_has_moved_nothing_is_over_at_once():
    s = Harness()
    s.parsed()
    stated = s.says("HALT C-1")
    assert stated[0] == "tell ann Accepted C-2"
    assert [line for line in stated if line.startswith("end")] == ["end C-2 succeeded", "end C-1 halted"]


def test_a_step_may_move_only_what_its_script_has_claimed():
    s = Harness()
    s.elaborated()
    assert s.answers("C-1", bound("C-1.1", "LEFT-ARM")) == ["note C-1 ended", "end C-1 refused"]
    assert s.outcome("C-1").refusal.reason is RefusalReason.PROGRAM


def test_the_request_of_a_long_command_outlives_thousands_of_short_ones(monkeypatch):
    monkeypatch.setattr(termination, "ENDED_KEPT", 5)
    monkeypatch.setattr(termination, "FORGOTTEN_AT_ONCE", 1)
    s = Harness()
    s.says("X", request="long")
    for n in range(20):
        s.says("HALT C-99", request=f"short-{n}")
    assert s.says("X", request="long") == ["tell ann Accepted C-1"]
    assert len(s.state.requests) <= 5 + len(s.state.commands)


def test_notes_are_sent_to_the_client_that_wants_them_and_to_listeners_and_kept_in_any_case():
    s = Harness()
    assert "note C-1 parsing" in s.says("X")
    assert [line for line in s.says("X", progress=False) if line.startswith("note")] == []
    assert s.handle(ListenersChanged, listening=True) == []
    assert "note C-3 parsing" in s.says("X", progress=False)
    s.handle(ListenersChanged, listening=False)
    assert [line for line in s.says("X", progress=False) if line.startswith("note")] == []
    assert all(len(command.notes) == 1 for command in s.state.commands.values())
    assert [e.client for e in s.log if isinstance(e, PublishNote)] == ["ann", ""]


def test_a_command_accepted_while_the_stream_is_crowded_publishes_its_end_alone():
    s = Harness()
    s.handle(ListenersChanged, listening=True)
    s.says("X", progress=False)
    s.handle(ListenersChanged, listening=True, crowded=True)
    s.says("Y", progress=False)
    assert "note C-3 parsing" in s.says("Z")  # its client wants them
    s.handle(ListenersChanged, listening=True)
    s.log.clear()
    for command in ("C-1", "C-2"):
        s.declines(command, RefusalReason.NAME)
    assert {e.note.command for e in s.log if isinstance(e, PublishNote)} == {"C-1"}
    ends = [e for e in s.log if isinstance(e, ReportEnd)]
    assert [e.ended.command for e in ends] == ["C-1", "C-2"]
    assert len(ends[1].record.notes) > 1
    assert s.state.counts["unwatched"] == 2


def test_a_restarted_broker_has_no_listeners_until_they_come_back():
    s = Harness()
    s.handle(ListenersChanged, listening=True)
    s.handle(BrokerRestarted)
    assert [line for line in s.says("X", progress=False) if line.startswith("note")] == []


# --- the table itself --------------------------------------------------------------------------------


def test_every_empty_cell_counts_and_changes_nothing():
    for phase in Phase:
        for stimulus in Stimulus:
            if (phase, stimulus) in COMMAND.cells:
                continue
            s = Harness()
            s.says("X")
            command = s.state.commands["C-1"]
            command.phase = phase
            turn = DecisionContext(s.state, 1.0)
            stimulate(turn, command, stimulus)
            assert (turn.effects, command.phase, s.state.counts["stale"]) == ([], phase, 1)


def test_an_action_that_leads_where_it_must_not_tells_the_story(monkeypatch):
    s = Harness()
    s.parsed()
    cell = (Phase.ELABORATING, Stimulus.PRODUCT)
    wrong = COMMAND.cells[cell]._replace(action=lambda context, command, _: context.enter(command, Phase.CLOSING))
    monkeypatch.setitem(COMMAND.cells, cell, wrong)
    with pytest.raises(
        InvalidTransition, match=r"C-1: product in elaborating led to closing(.|\n)*0\.00\d elaborating"
    ):
        s.answers("C-1", script())


def test_reports_of_unknown_primitives_are_acknowledged():
    assert Harness().reports("C-9", primitive="C-9.1") == ["ack C-9.1"]
    assert report("C-9.1").reason is StopReason.GOAL


# --- time limits -------------------------------------------------------------------------------------


def time_left(s: Harness, command: str = "C-1") -> float:
    return s.state.commands[command].due_s - s.now


@pytest.mark.parametrize(("timeout_scale", "limit_s"), [(0.5, 2.0), (1.0, 2.0), (3.0, 6.0)])
def test_every_kind_of_halt_has_the_same_time_limit(timeout_scale, limit_s):
    by_sentence, by_socket = Harness(), Harness()
    for s in (by_sentence, by_socket):
        s.state.timeout_scale = timeout_scale
        s.executing()
    by_sentence.says("HALT ALL")
    by_socket.halts()
    assert time_left(by_sentence, "C-2") == time_left(by_sentence) == time_left(by_socket) == pytest.approx(limit_s)


def test_after_a_restart_a_halt_has_its_limit_and_time_to_reconnect():
    s = Harness()
    s.state.timeout_scale = 3.0
    s.executing()
    s.says("HALT ALL")
    s.handle(BrokerRestarted)
    assert time_left(s) == time_left(s, "C-2") == pytest.approx(6.0 + REPORT_MARGIN_S)


def test_after_a_restart_the_last_analysis_has_its_whole_limit():
    s = Harness()
    s.executing()
    s.halts()
    s.reports("C-1", StopReason.HALT)
    assert s.phase("C-1") == "closing"
    s.handle(BrokerRestarted)
    assert time_left(s) == pytest.approx(CLOSING_LIMIT_S)
