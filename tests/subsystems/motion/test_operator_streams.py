"""The first runs of the campaign of operator streams, and that its judge finds rules that are broken on purpose."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from rtc.subsystems.motion import jog, operation
from rtc.subsystems.motion.operation import OperatedArm
from tests.campaigns.operator_streams import one_run

RUNS = 8


def test_no_stream_moves_an_arm_against_f_or_its_grant() -> None:
    found: Counter[str] = Counter()
    assert [words for number in range(RUNS) for words in one_run(number, found)] == []
    assert found["counted"] > 50
    assert found["refused"] > 20


@pytest.mark.parametrize(
    ("number", "where", "rule", "broken", "words"),
    [
        (0, operation, "LOST_S", 0.12, "after it had to rest"),
        (4, operation, "STALE_S", 0.5, "counts"),
        (5, OperatedArm, "_inside", lambda self, linear, tcp: linear, "outside the neighbourhood"),
        (1, OperatedArm, "_is_moved_by_another", lambda self, caller, now_s: False, "counts"),
        (6038, operation, "BEYOND_M", 1.0, "outside the neighbourhood"),
        (0, jog, "STOP_ACCELERATION_RAD_S2", 40.0, "beyond its limits"),
    ],
)
def test_the_judge_finds_a_broken_rule(
    number: int, where: Any, rule: str, broken: Any, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(where, rule, broken)
    assert any(words in one for one in one_run(number, Counter()))
