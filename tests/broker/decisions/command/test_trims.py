"""Trims: corrections of a failed step, pushed onto the stack of steps."""

from __future__ import annotations

import msgspec
import pytest

from rtc.protocol.messages import NoteKind
from rtc.protocol.outcomes import Compared, Figure, OutcomeKind, StopReason
from tests.broker.harness import Harness, bound, give_up, go_on, mend, script, trim

# --- trims --------------------------------------------------------------------------------------------


def test_a_trim_goes_on_the_stack_and_the_step_is_tried_again():
    s = Harness()
    s.analyzing(script(trims=[trim(1)]), StopReason.GOAL)
    assert s.answers("C-1", mend(1)) == ["note C-1 analyzing", "job C-1/5 binder #1", "note C-1 binding"]
    s.answers("C-1", bound("C-1.2"))
    s.reports("C-1")
    s.answers("C-1", go_on())
    assert s.state.commands["C-1"].actions.step == (0, 0)  # the step itself, once more
    assert s.state.commands["C-1"].actions.trim_labels == ("trim 1",)


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
    assert "after that" in outcome.message  # wording: the order of the two causes


def test_giving_up_reports_the_failure():
    s = Harness()
    s.analyzing()
    assert s.answers("C-1", give_up()) == ["note C-1 ended", "end C-1 failed"]
    assert s.outcome("C-1").stop is StopReason.FORCE_LIMIT
    assert s.outcome("C-1").step == "1 of 1: step 1"


# --- words --------------------------------------------------------------------------------------------


def test_a_step_of_a_trim_has_its_own_words():
    s = Harness()
    s.analyzing(script(trims=[trim()]))
    s.answers("C-1", mend())
    assert s.state.commands["C-1"].step_words == "trim 1, 1 of 1: mend"


# --- what was predicted -------------------------------------------------------------------------------


def test_a_drift_is_a_warning_with_its_figures_and_the_command_goes_on():
    s = Harness()
    s.analyzing(script(steps=2))
    found = Compared("LIFT", "move_held", [Figure("duration_s", 1.8, 2.5, 0.2)])
    s.answers("C-1", msgspec.structs.replace(go_on(), compared=found, drift="took 2.50 s"))
    note = next(one for one in s.state.commands["C-1"].notes if one.compared)
    assert (note.compared, note.warning) == (found, True)
    assert (note.kind, note.drift) == (NoteKind.JUDGED, "took 2.50 s")
    assert s.state.commands["C-1"].steps_done == 1


def test_a_trim_after_a_good_step_does_not_repeat_it():
    s = Harness()
    s.analyzing(script(steps=2, trims=[trim(1, "skip")]))
    s.answers("C-1", msgspec.structs.replace(mend(1), reason=StopReason.GOAL))
    assert next(one for one in s.state.commands["C-1"].notes if one.trim).trim == 1
    s.answers("C-1", bound("C-1.2"))
    s.reports("C-1")
    s.answers("C-1", go_on())
    assert s.state.commands["C-1"].actions.step == (0, 1)
