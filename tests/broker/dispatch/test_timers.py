"""Timers by name, the nearest first."""

from broker.dispatch.timers import DEAD_KEPT, Timers


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
