"""What the gateway makes of measurements that come over a slow link, by another clock."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rtc.apps.console.hub import Hub
from rtc.apps.console.pages import Mailbox
from rtc.apps.observers.feed import Received
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Outcome, OutcomeKind
from rtc.protocol.rehearsal import Rehearsal

DELAY_S, AHEAD_S = 3.0, 500.0  # one way; what the far clock is ahead of ours


def clocks(hub: Hub) -> list[float]:
    """What a page that opens now gets to know."""
    texts: list[dict[str, Any]] = [msgspec.json.decode(text) for text in hub.anew()]
    return [text["clock_s"] for text in texts if "clock_s" in text]


def hub_of(cell: Cell) -> Hub:
    return Hub(cell, lambda: 1000.0, {})


def end_of_test(command: str) -> Received:
    rehearsal = Rehearsal(relies_on={"RIGHT-ARM.joints": 3})
    outcome = Outcome(kind=OutcomeKind.SUCCEEDED, rehearsal=rehearsal)
    ended = m.CommandEnded(
        command=command, request="", text="TEST STOW RIGHT-ARM", outcome=outcome, seq=1, at_s=1.0, took_s=0.1
    )
    return Received(at_s=1.0, message=ended)


def predictions(hub: Hub) -> list[str]:
    texts: list[dict[str, Any]] = [msgspec.json.decode(text) for text in hub.anew()]
    return [one["command"] for text in texts for one in text.get("predictions", [])]


@pytest.mark.parametrize("answer_first", [True, False])
def test_a_page_gets_the_tests_of_pages_alone(cell: Cell, answer_first: bool):
    hub = hub_of(cell)
    hub.take([end_of_test("C-1")])
    if answer_first:
        hub.take_of_page("C-2")
    hub.take([end_of_test("C-2"), end_of_test("C-3")])
    hub.take_of_page("C-2")
    assert predictions(hub) == ["C-2"]


def test_a_prediction_is_gone_when_a_fact_that_it_relies_on_has_changed(cell: Cell):
    hub = hub_of(cell)
    for command in ("C-1", "C-2"):
        hub.take_of_page(command)
        hub.take([end_of_test(command)])
    fact = m.Fact(key="RIGHT-ARM.joints", value=[0.0] * 7, validity=m.Validity.VALID, version=3, source="", at_s=1.0)
    hub.take([Received(at_s=1.0, message=m.View(request="", version=3, facts=[fact]))])
    assert predictions(hub) == ["C-1", "C-2"]
    later = msgspec.structs.replace(fact, version=4)
    hub.take([Received(at_s=1.0, message=m.View(request="", version=4, facts=[later]))])
    assert predictions(hub) == []


@pytest.mark.parametrize(("hello", "offset_s"), [({"delay_s": DELAY_S}, -AHEAD_S), ({}, 0.0)])
def test_the_age_of_a_measurement_is_that_of_its_way_whatever_its_clock(cell: Cell, hello: Any, offset_s: float):
    now_s = [1000.0]
    hub = Hub(cell, lambda: now_s[0], hello)
    hub.boxes.add(Mailbox(hub.anew))
    for late_s in (0.4, 0.0, 0.2):
        at_s = now_s[0] + AHEAD_S - DELAY_S - late_s
        hub.take(
            [
                Received(
                    at_s=now_s[0],
                    message=m.Telemetry(subsystem="MCM", at_s=at_s, sim_s=0.0, late_ticks=0, ticks=1, arms={}),
                )
            ]
        )
        now_s[0] += 0.1
    assert clocks(hub) == [pytest.approx(offset_s)]
