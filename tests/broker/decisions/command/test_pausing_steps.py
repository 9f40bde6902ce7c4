"""Breakpoints and single steps: a command pauses before a chosen step, and performs one at a time (R101)."""

from __future__ import annotations

import pytest

from broker.decisions.events import BreakpointsChanged, StepRequested
from rtc.protocol.messages import Breakpoint, Phase
from tests.broker.harness import Harness, bound, go_on, script


@pytest.fixture
def s():
    return Harness()


def paused_before_second(s):
    s.handle(BreakpointsChanged, breakpoints=[Breakpoint("GRASP", 2)])
    s.analyzing(script(3))
    s.answers("C-1", go_on())
    return s.state.commands["C-1"]


def does_step(s):
    """Bound, executed and assessed."""
    s.answers("C-1", bound(f"C-1.{s.state.commands['C-1'].primitives + 1}"))
    s.reports("C-1")
    s.answers("C-1", go_on())


def resumes(s):
    s.parsed(kind="control", verb="RESUME", object="C-1")


def test_a_command_pauses_before_the_step_of_a_breakpoint(s):
    command = paused_before_second(s)
    assert (command.phase, command.steps_done) == (Phase.PAUSED, 1)


def test_one_step_is_performed_and_it_pauses_again(s):
    command = paused_before_second(s)
    s.handle(StepRequested, command="C-1")
    assert command.phase is Phase.BINDING
    does_step(s)
    assert (command.phase, command.steps_done) == (Phase.PAUSED, 2)


def test_after_resume_it_goes_on_past_its_breakpoint_and_without_single_steps(s):
    command = paused_before_second(s)
    s.handle(StepRequested, command="C-1")
    does_step(s)
    resumes(s)
    assert command.phase is Phase.BINDING
    does_step(s)
    assert "C-1" not in s.state.commands


def test_a_resume_during_a_single_step_ends_the_single_steps(s):
    command = paused_before_second(s)
    s.handle(StepRequested, command="C-1")
    resumes(s)
    does_step(s)
    assert command.phase is Phase.BINDING


def test_a_step_of_a_command_that_is_not_paused_changes_nothing(s):
    s.executing(script(2))
    assert s.handle(StepRequested, command="C-1") == []
    assert s.state.commands["C-1"].phase is Phase.EXECUTING
    assert s.handle(StepRequested, command="C-99") == []


def test_another_verb_and_removed_breakpoints_do_not_pause(s):
    s.handle(BreakpointsChanged, breakpoints=[Breakpoint("GRASP", 2)])
    s.handle(BreakpointsChanged, breakpoints=[Breakpoint("MOVE", 2)])
    s.analyzing(script(2))
    s.answers("C-1", go_on())
    assert s.state.commands["C-1"].phase is Phase.BINDING
