"""The table of a command as a whole."""

from __future__ import annotations

import pytest

from broker.decisions.command.table import COMMAND, stimulate
from broker.decisions.context import DecisionContext
from broker.decisions.events import (
    Stimulus,
)
from broker.decisions.machine import InvalidTransition
from rtc.protocol.messages import Phase
from rtc.protocol.outcomes import StopReason
from tests.broker.harness import Harness, report, script


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
