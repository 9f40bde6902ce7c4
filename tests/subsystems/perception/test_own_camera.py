"""The camera of docs/own-subsystem.md, without its process: the result of LOCATE through it shows the pose."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.subsystems.base.subsystem import BROKER

PAGE = Path(__file__).parents[3] / "docs" / "own-subsystem.md"


@pytest.fixture
def tracker() -> Any:
    (code,) = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)[:1]
    names: dict[str, Any] = {"__name__": "tracker"}
    exec(code.rpartition("\nmain(")[0], names)
    return names["Tracker"]([0.78, -0.80, 0.60])


@pytest.mark.parametrize("items", [["POSITION"], []])
def test_a_pose_that_the_sentence_asks_for_is_in_the_reading(tracker: Any, items: list[str]) -> None:
    look = p.Primitive(
        id="C-1.1",
        performer="CAMERA-1",
        trajectory=p.Look(tags=[p.TagGeometry(id=1, size_m=0.06, pose=[0.0] * 6 + [1.0])], believed=[0.0] * 6 + [1.0]),
        stop_functions=[
            p.StopFunction(reason=StopReason.FOUND, when=p.GoalReached()),
            p.StopFunction(reason=StopReason.TIMEOUT, when=p.TimeAbove(20.0)),
        ],
        reporting=p.Reporting(items=items),
    )
    tracker.handle(m.Execute(primitive=look), BROKER, 0.0)
    (report,) = [one for _, one in tracker.tick(10.0) if isinstance(one, m.EndReport)]
    assert report.sighting is not None
    if items:
        assert report.reading.sighting == report.sighting
    else:
        assert report.reading is None
