"""The Action_Stack alone: order of steps, trims, and the payloads of jobs."""

from __future__ import annotations

import pytest

from rtc.programs import action_stack
from rtc.programs.action_stack import MAX_TRIMS, ActionStack
from rtc.protocol.messages import Binding
from tests.broker.harness import script, trim


def labels(actions: ActionStack) -> list[str]:
    """The labels of all steps that are left, in order."""
    left = []
    while actions.refs:
        actions.pop()
        left.append(actions.step_body.label)
    return left


def test_the_steps_come_in_the_order_of_the_script():
    assert labels(action_stack.begin(script(steps=3))) == ["step 1", "step 2", "step 3"]


@pytest.mark.parametrize(
    ("then", "left"),
    [
        ("retry_step", ["mend", "step 1", "step 2"]),
        ("restart_script", ["mend", "step 1", "step 2"]),
        ("skip", ["mend", "step 2"]),
        ("replace_rest", ["mend"]),
        ("give_up", ["mend"]),
    ],
)
def test_a_trim_comes_first_and_what_follows_is_its_own_choice(then, left):
    actions = action_stack.begin(script(steps=2, trims=[trim(1, then)]))
    actions.pop()
    assert actions.push_trim(1) is not None
    assert labels(actions) == left


def test_several_trims_follow_one_another_and_the_last_decides_what_comes_then():
    actions = action_stack.begin(script(steps=2, trims=[trim(1, "replace_rest"), trim(2, "skip", steps=2)]))
    actions.pop()
    assert actions.push_trim(1, [9]) is None
    assert actions.push_trim(1, [1]) is None
    assert actions.push_trim(1, [2]).n == 2
    assert labels(actions) == ["mend", "mend", "mend", "step 2"]
    assert actions.trim_labels == ("trim 1", "trim 2")


def test_a_restart_of_the_script_restores_its_values():
    actions = action_stack.begin(script(trims=[trim(1, "restart_script")]))
    actions.pop()
    actions.assign({"JAP": Binding(number=2.0)})
    actions.push_trim(1)
    assert actions.bindings["JAP"].number == 1.0


def test_a_trim_is_used_once_per_step_and_unknown_ones_are_refused():
    actions = action_stack.begin(script(trims=[trim(1, steps=0)]))
    actions.pop()
    assert actions.push_trim(9) is None
    assert actions.push_trim(1) is not None
    actions.pop()
    assert actions.analyzer_input(None, None).trims_used == [1]
    assert actions.push_trim(1) is None
    assert actions.trim_labels == ("trim 1",)


def test_above_the_limit_only_a_trim_that_gives_up_is_pushed():
    trims = [trim(n, "retry_step", steps=0) for n in range(1, MAX_TRIMS + 2)] + [trim(99, "give_up", steps=0)]
    actions = action_stack.begin(script(trims=trims))
    actions.pop()
    for n in range(1, MAX_TRIMS + 1):
        assert actions.push_trim(n) is not None
        actions.pop()
    assert actions.push_trim(MAX_TRIMS + 1) is None
    assert actions.push_trim(99) is not None


def test_a_payload_keeps_the_values_it_was_made_with():
    actions = action_stack.begin(script())
    actions.pop()
    before = actions.binder_input("C-1.1")
    actions.assign({"JAP": Binding(number=2.0)})
    assert before.bindings["JAP"].number == 1.0
    assert actions.binder_input("C-1.1").bindings["JAP"].number == 2.0
