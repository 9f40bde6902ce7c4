"""An allowance per second."""

from __future__ import annotations

from rtc.runtime.allowance import Allowance


def test_an_allowance_is_renewed_after_a_second() -> None:
    allowance = Allowance(3)
    assert [allowance.take(7.0 + n / 10) for n in range(5)] == [True, True, True, False, False]
    assert not allowance.take(7.99)
    assert allowance.take(8.0)


def test_each_user_has_its_own_and_a_use_may_cost_more() -> None:
    allowance = Allowance(10)
    assert [allowance.take(1.0, "ann", 5) for _ in range(3)] == [True, True, False]
    assert allowance.take(1.0, "ben", 10)


def test_a_use_without_cost_shows_whether_it_is_exceeded() -> None:
    allowance = Allowance(1)
    assert allowance.take(1.0)
    assert allowance.take(1.0, cost=0)
    assert not allowance.take(1.0)
    assert not allowance.take(1.9, cost=0)
    assert allowance.take(2.0, cost=0)
