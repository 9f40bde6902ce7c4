"""The page in the docs is drawn from the table; this draws it anew and compares."""

from __future__ import annotations

from pathlib import Path

from broker.decisions import transitions
from broker.decisions.events import Stimulus
from broker.decisions.transitions import TABLE
from rtc.protocol.messages import Phase

PAGE = Path(__file__).parents[2] / "docs" / "decision_unit.md"


def test_the_docs_show_the_table_as_it_is():
    page = PAGE.read_text()
    hint = "draw it anew: python -m broker.decisions.transitions > docs/decision_unit.md"
    assert page == transitions.as_page(), hint


def test_every_phase_but_the_last_can_be_stopped_or_is_stopping():
    leading_out = {phase for phase, stimulus in TABLE if stimulus is Stimulus.STOP}
    assert set(Phase) - leading_out == {Phase.HALTING, Phase.CLOSING, Phase.ENDED}


def test_every_phase_can_reach_the_end():
    reached = {Phase.ENDED}
    while True:
        more = {phase for (phase, _), (_, after) in TABLE.items() if after & reached} - reached
        if not more:
            break
        reached |= more
    assert reached == set(Phase)
