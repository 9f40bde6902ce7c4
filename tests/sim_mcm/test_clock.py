"""When ticks are due, and which are late."""

from __future__ import annotations

import pytest

from sim_mcm.clock import CATCH_UP_S, Clock


def run(clock: Clock, now_s: float, ticks: int, cost_s: float, busy: bool = True) -> float:
    for _ in range(ticks):
        now_s += clock.left_s(now_s, busy)
        clock.begin(now_s)
        now_s += cost_s
    return now_s


@pytest.mark.parametrize(("speed", "took_s"), [(1.0, 1.0), (2.0, 0.5), (0.5, 2.0)])
def test_simulated_time_keeps_its_speed(speed: float, took_s: float) -> None:
    clock = Clock(speed, 10.0)
    end_s = run(clock, 10.0, 1000, 0.0001)
    assert end_s - 10.0 == pytest.approx(took_s, rel=0.01)
    assert clock.sim_s == pytest.approx(1.0)
    assert clock.late_ticks == 0


def test_as_fast_as_possible_while_busy_and_in_real_time_while_not() -> None:
    clock = Clock(0.0, 0.0)
    busy_s = run(clock, 0.0, 1000, 0.0001)
    assert busy_s == pytest.approx(0.1)
    idle_s = run(clock, busy_s, 1000, 0.0001, busy=False) - busy_s
    assert idle_s == pytest.approx(1.0, rel=0.01)
    assert clock.late_ticks == 0


def test_a_tick_is_late_when_it_begins_more_than_a_period_after_it_was_due() -> None:
    clock = Clock(1.0, 0.0)
    now_s = run(clock, 0.0, 100, 0.0001)
    clock.begin(now_s + 0.0015)
    assert clock.late_ticks == 0
    clock.begin(now_s + 0.0045)
    assert clock.late_ticks == 1


def test_a_short_delay_is_made_up_for_and_a_long_one_is_not() -> None:
    clock = Clock(1.0, 0.0)
    now_s = run(clock, 0.0, 100, 0.0001) + 0.5 * CATCH_UP_S
    now_s = run(clock, now_s, 100, 0.0001)
    assert now_s == pytest.approx(0.2, abs=0.002)
    now_s = run(clock, now_s + 10.0, 100, 0.0001)
    assert now_s == pytest.approx(10.3, abs=0.003)


def test_a_clock_that_cannot_keep_its_speed_is_overloaded_and_one_that_was_stopped_is_not() -> None:
    clock = Clock(1.0, 0.0)
    now_s = run(clock, 0.0, 5_000, 0.0009)
    for _ in range(20):
        now_s = run(clock, now_s + 5.0, 10_000, 0.0009)
        assert not clock.overloaded()
    run(clock, now_s, 5_000, 0.0011)
    assert clock.overloaded()
    assert not clock.overloaded()
