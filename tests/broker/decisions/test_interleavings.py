"""Orders of messages that the exploration of all interleavings found (tests/simulation)."""

from __future__ import annotations

import pytest

from broker.decisions.effects import SendHalt, SendPrimitive
from broker.decisions.events import (
    HaltCalled,
    HaltConfirmed,
    TimerFired,
)
from rtc.protocol.outcomes import StopReason
from tests.broker.harness import Harness, bound, go_on, record, script


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
    first, second = (e.order.halt for e in s.log if isinstance(e, SendHalt))
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
