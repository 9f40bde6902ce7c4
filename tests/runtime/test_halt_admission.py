"""Halts from outside, before anybody obeys them: whose names they may bear, and what becomes of a stream of them."""

from __future__ import annotations

import math

import pytest

from rtc.protocol import wire
from rtc.protocol.messages import HaltOrder
from rtc.protocol.outcomes import WireError
from rtc.runtime.halt_admission import MERGE_S, PER_S, HaltRateLimiter, read_order, sanitize_halt


@pytest.mark.parametrize("name", ["C-7", "stop-C-7", "orphan-C-7.1", "rejoin-MCM-1.0", "declined-3"])
def test_a_name_of_the_brokers_own_is_changed(name: str) -> None:
    assert sanitize_halt(HaltOrder(halt=name)).halt == f"H-{name}"


@pytest.mark.parametrize("at_s", [math.nan, math.inf, -math.inf, -1.0])
def test_an_invalid_time_is_not_passed_on(at_s: float) -> None:
    assert sanitize_halt(HaltOrder(halt="H-1", called_at_s=at_s)).called_at_s == 0.0


@pytest.mark.parametrize("scope", ["right-arm", "Right-Arm", " RIGHT-ARM "])
def test_a_scope_in_small_letters_is_that_of_capitals(scope: str) -> None:
    message = {"type": "HaltOrder", "halt": "H-1", "scope": scope}
    assert read_order([wire.PROTOCOL, wire.encode(message)]).scope == "RIGHT-ARM"


def test_an_honest_halt_is_left_alone() -> None:
    order = HaltOrder(halt="H-1", scope="RIGHT-ARM", called_at_s=12.5)
    assert sanitize_halt(order) is order


@pytest.mark.parametrize(
    "wrong",
    [
        {"called_at_s": "soon"},
        {"called_at_s": True},
        {"called_at_s": None},
        {"called_at_s": [1]},
        {"called_at_s": math.nan},
        {"call": 7},
        {"halt": 7},
        {"halt": None},
        {"halt": "x" * 5_000},
        {"halt": "C-" + "9" * 198},  # 200 characters, before it is changed
    ],
)
def test_a_halt_whose_scope_can_be_read_is_obeyed_whatever_else_is_wrong_with_it(wrong) -> None:
    message = {"type": "HaltOrder", "halt": "H-1", "scope": "RIGHT-ARM", "called_at_s": 12.5, **wrong}
    order = read_order([wire.PROTOCOL, wire.encode(message)])
    assert order.scope == "RIGHT-ARM"
    assert wire.reader(HaltOrder)(wire.frames(order)) == order  # and it can be passed on


@pytest.mark.parametrize("message", [{"scope": 7}, {"type": "HaltStarted"}, {"scope": "x" * 201}, [], 7])
def test_what_names_no_scope_is_no_halt(message) -> None:
    if isinstance(message, dict):
        message = {"type": "HaltOrder", "halt": "H-1", **message}
    with pytest.raises(WireError):
        read_order([wire.PROTOCOL, wire.encode(message)])


def test_a_caller_calls_exceeds_within_a_second_and_another_does_not() -> None:
    limiter = HaltRateLimiter()
    assert not any(limiter.exceeds(b"x", 1.0) for _ in range(PER_S))
    assert limiter.exceeds(b"x", 1.5)
    assert not limiter.exceeds(b"y", 1.5)
    assert not limiter.exceeds(b"x", 2.1)


def test_merged_halts_are_sent_once_and_never_cover_less_than_was_called() -> None:
    limiter = HaltRateLimiter()
    assert limiter.due(1.0) is None
    limiter.merge(HaltOrder(halt="a", scope="LEFT-ARM"))
    assert limiter.merge(HaltOrder(halt="b", scope="LEFT-ARM")).scope == "LEFT-ARM"
    assert limiter.due(1.0) == HaltOrder(halt="b", scope="LEFT-ARM")
    limiter.merge(HaltOrder(halt="c", scope="LEFT-ARM"))
    limiter.merge(HaltOrder(halt="d", scope="C-7"))
    limiter.merge(HaltOrder(halt="e", scope="C-7"))
    assert limiter.due(1.0 + MERGE_S / 2) is None
    assert limiter.due(1.0 + MERGE_S) == HaltOrder(halt="e", scope="ALL")
    assert limiter.due(9.0) is None
