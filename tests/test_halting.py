"""Halts from outside, before anybody obeys them: whose names they may bear, and what becomes of a stream of them."""

from __future__ import annotations

import math

import pytest

from rtc.halting import FOLD_S, PER_S, Fold, as_a_callers
from rtc.messages import HaltOrder


@pytest.mark.parametrize("name", ["C-7", "stop-C-7", "orphan-C-7.1", "rejoin-MCM-1.0", "declined-3"])
def test_a_name_of_the_brokers_own_is_changed(name: str) -> None:
    assert as_a_callers(HaltOrder(halt=name)).halt == f"H-{name}"


@pytest.mark.parametrize("at_s", [math.nan, math.inf, -math.inf, -1.0])
def test_a_time_that_is_none_is_not_told(at_s: float) -> None:
    assert as_a_callers(HaltOrder(halt="H-1", called_at_s=at_s)).called_at_s == 0.0


def test_an_honest_halt_is_left_alone() -> None:
    order = HaltOrder(halt="H-1", scope="RIGHT-ARM", called_at_s=12.5)
    assert as_a_callers(order) is order


def test_a_caller_calls_too_often_within_a_second_and_another_does_not() -> None:
    fold = Fold()
    assert not any(fold.too_often(b"x", 1.0) for _ in range(PER_S))
    assert fold.too_often(b"x", 1.5)
    assert not fold.too_often(b"y", 1.5)
    assert not fold.too_often(b"x", 2.1)


def test_what_is_folded_is_said_once_and_never_less_than_was_called() -> None:
    fold = Fold()
    assert fold.due(1.0) is None
    fold.add(HaltOrder(halt="a", scope="LEFT-ARM"))
    assert fold.add(HaltOrder(halt="b", scope="LEFT-ARM")).scope == "LEFT-ARM"
    assert fold.due(1.0) == HaltOrder(halt="b", scope="LEFT-ARM")
    fold.add(HaltOrder(halt="c", scope="LEFT-ARM"))
    fold.add(HaltOrder(halt="d", scope="C-7"))
    fold.add(HaltOrder(halt="e", scope="C-7"))
    assert fold.due(1.0 + FOLD_S / 2) is None
    assert fold.due(1.0 + FOLD_S) == HaltOrder(halt="e", scope="ALL")
    assert fold.due(9.0) is None
