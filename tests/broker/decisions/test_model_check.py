"""The model check, to a small bound: every interleaving near the start is good, and a broken rule would be found.

The whole of it: `python -m tests.campaigns.model_check`.
"""

from __future__ import annotations

import msgspec
import pytest

from broker.decisions import decide, deferred_analysis, halt_request
from broker.decisions.command import stopping
from broker.decisions.context import DecisionContext
from broker.decisions.effects import SendHalt
from broker.decisions.events import HaltCalled, JobLost, JournalLost, SubsystemConnected
from broker.decisions.resources import Resources
from rtc.protocol.messages import HaltOrder
from tests.simulation.explore import describe, explore
from tests.simulation.model import Scenario
from tests.simulation.scenarios import SCENARIOS

SAME_ARM, ONE_CLIENT = (next(s for s in SCENARIOS if s.name == name) for name in ("same arm", "same arm, one client"))


def faults(scenario: Scenario, n: int) -> Scenario:
    return msgspec.structs.replace(scenario, faults=n)


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda s: s.name.replace(" ", "-"))
def test_nothing_near_the_start_breaks_a_rule(scenario):
    found = explore(faults(scenario, 2), states=400)
    assert not found.violation, describe(found, scenario)
    assert found.states > 400


def test_without_faults_all_there_is_is_explored():
    found = explore(faults(SAME_ARM, 0))
    assert found.complete
    assert not found.violation
    assert found.states > 50


# --- rules broken on purpose: each must be found, by the shortest way --------------------------------


def test_a_halt_that_forgets_what_is_in_line_is_found(monkeypatch):
    monkeypatch.setattr(halt_request, "in_scope", lambda turn, scope: [])
    found = explore(faults(SAME_ARM, 1))
    assert found.violation
    assert [move[0] for move in found.path] == ["hand in", "halt", "delivered", "work"]
    assert "the shortest way there" in describe(found, SAME_ARM)


def test_a_resource_given_twice_is_found(monkeypatch):
    monkeypatch.setattr(Resources, "blocker", lambda self, command, claim: None)
    found = explore(faults(SAME_ARM, 0))
    assert "and one of them alone" in found.violation


def test_a_sentence_taken_up_before_one_given_earlier_is_found(monkeypatch):
    monkeypatch.setattr(DecisionContext, "is_next", lambda self, command: True)
    found = explore(faults(ONE_CLIENT, 0))
    assert "C-1, which was given before it" in found.violation


def test_a_command_that_nothing_can_end_is_found(monkeypatch):
    monkeypatch.setitem(decide.HANDLERS, JobLost, lambda turn, event: None)
    assert "C-1 is still parsing" in explore(faults(SAME_ARM, 1)).violation


def test_a_halt_that_waits_for_a_confirmation_it_never_asked_for_is_found(monkeypatch):
    monkeypatch.setattr(stopping, "order_halt", lambda turn, command: None)  # no halt goes out, and no timer runs
    assert "nothing more happens, and" in explore(faults(SAME_ARM, 2)).violation


def test_a_subsystem_not_asked_what_it_still_does_is_found(monkeypatch):
    def deaf(turn, event):
        hello = msgspec.structs.replace(event.hello, outstanding=[], at_rest=True)
        decided(turn, msgspec.structs.replace(event, hello=hello))

    decided = decide.HANDLERS[SubsystemConnected]
    monkeypatch.setitem(decide.HANDLERS, SubsystemConnected, deaf)
    assert "still executes" in explore(faults(SAME_ARM, 1)).violation


def test_a_halt_called_past_the_broker_and_not_passed_on_is_found(monkeypatch):
    """The subsystem tells of it; a Decision Unit that will not listen leaves it beginning nothing for ever."""
    called = decide.HANDLERS[HaltCalled]
    monkeypatch.setitem(
        decide.HANDLERS, HaltCalled, lambda turn, event: None if event.client == "MCM" else called(turn, event)
    )
    assert explore(faults(SAME_ARM, 1)).violation


def test_an_arm_that_stays_closed_because_the_world_is_never_written_is_found(monkeypatch):
    monkeypatch.setattr(deferred_analysis, "handle_timer", lambda turn, timer: False)
    assert "quarantine is not empty" in explore(faults(SAME_ARM, 1)).violation


@pytest.mark.parametrize(("by_subsystem", "move"), [(False, "halt again"), (True, "estop")])
def test_a_halt_that_is_not_obeyed_because_its_name_was_used_before_is_found(monkeypatch, by_subsystem, move):
    """Two callers may count their halts from one; a button may always say the same."""

    def only_once(turn, event):
        known = any(key.startswith(f"{event.order.halt} ") for key in turn.state.halts)
        if known and (event.client == "MCM") is by_subsystem:
            turn.effects.append(
                SendHalt(subsystem="MCM", order=HaltOrder(halt=event.order.halt, scope="C-99", call=event.order.call))
            )
        else:
            called(turn, event)

    called = decide.HANDLERS[HaltCalled]
    monkeypatch.setitem(decide.HANDLERS, HaltCalled, only_once)
    found = explore(faults(SAME_ARM, 2))
    assert found.violation
    assert move in [done[0] for done in found.path]


def test_a_journal_that_was_lost_without_a_consequence_is_found(monkeypatch):
    monkeypatch.setitem(decide.HANDLERS, JournalLost, lambda turn, event: None)
    scenario = next(s for s in SCENARIOS if s.name == "a lost journal")
    assert "after its journal was lost" in explore(faults(scenario, 1)).violation
