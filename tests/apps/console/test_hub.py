"""What the gateway makes of measurements that come over a slow link, by another clock."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rtc.apps.console.hub import Hub, InWords
from rtc.apps.console.pages import Mailbox
from rtc.apps.observers.feed import Received
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m

DELAY_S, AHEAD_S = 3.0, 500.0  # one way; what the far clock is ahead of ours


def clocks(hub: Hub) -> list[float]:
    """What a page that opens now gets to know."""
    texts: list[dict[str, Any]] = [msgspec.json.decode(text) for text in hub.anew()]
    return [text["clock_s"] for text in texts if "clock_s" in text]


@pytest.mark.parametrize(("hello", "offset_s"), [({"delay_s": DELAY_S}, -AHEAD_S), ({}, 0.0)])
def test_the_age_of_a_measurement_is_that_of_its_way_whatever_its_clock(cell: Cell, hello: Any, offset_s: float):
    now_s = [1000.0]
    words = InWords(why=lambda record: [], fact=lambda fact: "", names=lambda places, commands: None)
    hub = Hub(cell, words, lambda: now_s[0], hello)
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
