"""Timers by name, the nearest first."""

from broker.dispatch.timers import DEAD_KEPT, MAX_SLOWED, Timers


def test_due_in_order_and_only_once():
    t = Timers()
    t.start("b", 2.0)
    t.start("a", 1.0)
    assert t.next_at_s() == 1.0
    assert t.due(2.5) == ["a", "b"]
    assert t.due(9.0) == []


def test_a_new_time_replaces_the_old_and_stop_forgets():
    t = Timers()
    t.start("a", 1.0)
    t.start("a", 5.0)
    t.start("b", 2.0)
    t.stop("b")
    assert t.due(3.0) == []
    assert t.next_at_s() == 5.0


def test_timers_that_are_stopped_leave_nothing_behind():
    t = Timers()
    t.start("kept", 1.0)
    for n in range(10 * DEAD_KEPT):
        t.start(f"C-{n}", 2.0 + n)
        t.stop(f"C-{n}")
    assert len(t._heap) < 2 * DEAD_KEPT
    assert t.due(1e9) == ["kept"]


def slowed(t: Timers, share: float, until_s: float) -> float | None:
    """The MCM reports its own time four times a second; returns when the timer rings."""
    for quarter in range(int(4 * until_s)):
        now = quarter / 4
        t.set_own_time("MCM", 100.0 + share * now)
        if quarter == 0:
            t.start("C-1", 10.0, 0.0, ["MCM", "S&P"])  # S&P reports no time of its own
        if t.due(now):
            return now
    return None


def test_a_timer_waits_for_the_own_time_of_a_slow_subsystem():
    assert slowed(Timers(), 1.0, 30.0) == 10.0
    assert slowed(Timers(), 5.0, 30.0) == 10.0
    assert 100.0 <= slowed(Timers(), 0.1, 200.0) <= 100.5
    assert slowed(Timers(scale=10.0), 0.1, 30.0) == 10.0  # as slow as it is meant to be


def test_a_subsystem_that_stands_still_does_not_stop_the_clock_for_ever():
    assert slowed(Timers(), 0.0, 2000.0) == MAX_SLOWED * 10.0


def test_a_subsystem_that_reports_no_time_is_judged_by_ours():
    t = Timers()
    t.start("C-1", 10.0, 0.0, ["S&P"])
    assert t.due(10.0) == ["C-1"]


def test_the_time_of_another_process_does_not_count():
    t = Timers()
    t.set_own_time("MCM", 1000.0)
    t.start("C-1", 10.0, 0.0, ["MCM"])
    t.set_own_time("MCM", 2.0)  # it was restarted
    assert t.due(10.0) == []
    t.set_own_time("MCM", 12.0)
    assert t.due(20.0) == ["C-1"]


def test_a_timer_without_subsystems_replaces_one_with_them():
    t = Timers()
    t.set_own_time("MCM", 0.0)
    t.start("C-1", 10.0, 0.0, ["MCM"])
    t.start("C-1", 10.0)
    assert t.due(10.0) == ["C-1"]
