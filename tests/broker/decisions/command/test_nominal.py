"""From a sentence to its outcome, effect by effect and in order; and the refusals on the way."""

from __future__ import annotations

import msgspec
import pytest

from broker.decisions import events
from broker.decisions.resources import WORLD
from rtc.protocol import wire
from rtc.protocol.messages import AnalyzerInput, BoundStep
from rtc.protocol.outcomes import OutcomeKind, RefusalReason
from tests.broker.harness import Harness, bound, go_on, record, script, stated

# --- the nominal journey ------------------------------------------------------------------------------


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


def test_the_remark_of_a_step_is_shown_with_it_also_after_its_start():
    s = Harness()
    s.elaborated(script())
    s.answers("C-1", msgspec.structs.replace(bound("C-1.1"), remark="slowed to 2 mm/s"))
    s.handle(events.PrimitiveStarted, subsystem="MCM", primitive="C-1.1")
    assert s.state.commands["C-1"].step_words == "1 of 1: step 1 (slowed to 2 mm/s)"


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


def test_a_primitive_that_no_subsystem_could_read_is_not_sent():
    s = Harness()
    s.elaborated(script())
    product = msgspec.to_builtins(bound("C-1.1"))
    product["primitive"]["stop_functions"] = []
    assert not [line for line in s.answers("C-1", product) if line.startswith("primitive")]
    refusal = s.outcome("C-1").refusal
    assert refusal.reason is RefusalReason.PROGRAM
    assert "F is not complete" in refusal.message  # wording: what is wrong with the primitive


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


def test_neither_elaborator_nor_binder_receives_a_time_of_day():
    """The same sentence in the same world has the same plan, however long a busy machine has taken until then."""
    inputs = []
    for now in (100.0, 3700.0):
        s = Harness()
        s.now = now
        s.says("GRASP MODULE")
        s.answers("C-1", record())
        elaborates = s.state.commands["C-1"].job.input
        s.answers("C-1", script())
        inputs.append((elaborates, s.state.commands["C-1"].job.input))
    assert inputs[0] == inputs[1]


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


# --- refusals -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("reach", ["says", "parsed", "elaborated"])
def test_a_refusal_ends_the_command(reach):
    s = Harness()
    getattr(s, reach)(*["X"] if reach == "says" else [])
    assert s.declines("C-1") == ["note C-1 ended", "end C-1 refused"]


def test_an_analyzer_that_refuses_ends_the_command_and_closes_its_names_until_their_facts_are_suspect():
    s = Harness()
    s.analyzing(script(resources=("RIGHT-ARM", "MODULE")))
    assert s.declines("C-1") == ["note C-1 ended", "end C-1 refused", "timer C-1/4"]
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


def test_both_arms_of_a_control_are_all():
    s = Harness()
    s.executing()
    s.says("ABORT BOTH-ARMS")
    assert "halt C-1 to MCM" in s.answers("C-2", record(kind="control", verb="ABORT", hand="BOTH-ARMS"))
    s.says("HALT BOTH-ARMS")
    assert s.phase("C-1") == "halting"


def test_the_remark_of_the_last_step_is_in_the_outcome():
    s = Harness()
    s.analyzing()
    s.answers("C-1", msgspec.structs.replace(go_on(), remark="5 cm more"))
    assert s.outcome("C-1").kind is OutcomeKind.SUCCEEDED
    assert s.outcome("C-1").message == "5 cm more"  # wording: the remark of the analyzer
