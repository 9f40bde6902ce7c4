"""Commands wait for arms that others hold, and move only what they have claimed."""

from __future__ import annotations

from rtc.protocol.outcomes import RefusalReason
from tests.broker.harness import Harness, bound, go_on, record, script

# --- resources ----------------------------------------------------------------------------------------


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


# --- what exploring all interleavings found (tests/simulation) ----------------------------------------


def test_a_step_may_move_only_what_its_script_has_claimed():
    s = Harness()
    s.elaborated()
    assert s.answers("C-1", bound("C-1.1", "LEFT-ARM")) == ["note C-1 ended", "end C-1 refused"]
    assert s.outcome("C-1").refusal.reason is RefusalReason.PROGRAM
