"""The tables of the five machines: complete, able to end, and drawn in the docs as they are."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

import pytest

from broker.decisions.command.table import COMMAND
from broker.decisions.context import DecisionContext
from broker.decisions.events import Stimulus
from broker.decisions.machine import Ignored, InvalidTransition, Machine, cell
from broker.decisions.state import State
from rtc.protocol.messages import Phase
from tests import decision_unit_page
from tests.decision_unit_page import MACHINES

PAGE = Path(__file__).parents[3] / "docs" / "decision_unit.md"


def test_the_docs_show_the_tables_as_they_are():
    hint = "draw it anew: python -m tests.decision_unit_page > docs/decision_unit.md"
    assert PAGE.read_text() == decision_unit_page.as_page(), hint


@pytest.mark.parametrize("name", MACHINES)
def test_every_state_can_be_reached_from_the_first(name):
    machine, _ = MACHINES[name]
    reached = {machine.first}
    while (
        more := {a for (state, _), cell in machine.cells.items() if state in reached for a in cell.following} - reached
    ):
        reached |= more
    assert reached == set(machine.states)


def test_every_phase_but_the_last_can_be_stopped_or_is_stopping():
    leading_out = {phase for phase, stimulus in COMMAND.cells if stimulus is Stimulus.STOP}
    assert set(Phase) - leading_out == {Phase.HALTING, Phase.CLOSING, Phase.ENDED}


def test_every_phase_can_reach_the_end():
    reached = {Phase.ENDED}
    while more := {phase for (phase, _), (_, after) in COMMAND.cells.items() if after & reached} - reached:
        reached |= more
    assert reached == set(Phase)


class Lamp(StrEnum):
    OFF = "off"
    ON = "on"


class Press(StrEnum):
    DOWN = "down"
    UP = "up"


def lamp(rows, ignored):
    return Machine(Lamp, Press, rows, ignored, first=Lamp.OFF, state_of=lambda state, name: Lamp.OFF)


ROWS = {Lamp.OFF: {Press.DOWN: cell(print, Lamp.ON)}, Lamp.ON: {Press.DOWN: cell(print, Lamp.OFF)}}
UP = Ignored(Lamp, [Press.UP], "a switch acts when it is pressed")


def test_a_table_with_a_gap_or_with_two_entries_is_refused():
    lamp(ROWS, [UP])
    with pytest.raises(ValueError, match="no entry"):
        lamp(ROWS, [])
    with pytest.raises(ValueError, match="two entries"):
        lamp(ROWS, [UP, Ignored([Lamp.ON], [Press.DOWN], "twice")])


def test_a_machine_checks_where_an_action_leads():
    context = DecisionContext(State(), 0.0)
    rows = {Lamp.OFF: {Press.DOWN: cell(lambda *_: None, Lamp.ON)}, Lamp.ON: ROWS[Lamp.ON]}
    machine = lamp(rows, [UP])
    machine.run(context, "lamp", Press.UP)  # ignored
    with pytest.raises(InvalidTransition, match="lamp: down in off led to off"):
        machine.run(context, "lamp", Press.DOWN)
