"""The clock of the simulator, and hosts whose cores run tasks."""

from __future__ import annotations

from random import Random

import pytest

from benchmarks.hypercube.queues import NORMAL, REAL_TIME, Host, Simulation


def test_events_of_one_time_occur_in_the_order_in_which_they_were_scheduled():
    sim, seen = Simulation(), []
    for n in range(3):
        sim.after(1.0, seen.append, n)
    sim.after(0.5, seen.append, "first")
    sim.run(2.0)
    assert seen == ["first", 0, 1, 2]
    assert sim.now_s == 2.0


def ends(cores, *tasks):
    """Times at which tasks (priority, demand), all begun at 0, are complete."""
    sim, found = Simulation(), {}
    host = Host(sim, cores)
    for n, (priority, demand_s) in enumerate(tasks):
        host.work(priority, demand_s, lambda n: found.setdefault(n, sim.now_s), n)
    sim.run(1e6)
    return [pytest.approx(found[n]) for n in range(len(tasks))]


def test_tasks_with_a_core_each_do_not_delay_each_other():
    assert ends(None, (NORMAL, 1.0), (NORMAL, 2.0)) == [1.0, 2.0]
    assert ends(2, (NORMAL, 1.0), (NORMAL, 2.0)) == [1.0, 2.0]


def test_tasks_run_in_the_order_of_their_arrival():
    assert ends(1, (NORMAL, 1.0), (NORMAL, 1.0)) == [1.0, 2.0]
    assert ends(2, (NORMAL, 2.0), (NORMAL, 2.0), (NORMAL, 2.0)) == [2.0, 2.0, 4.0]


def test_a_real_time_task_takes_a_core_at_once():
    assert ends(1, (NORMAL, 1.0), (REAL_TIME, 1.0)) == [2.0, 1.0]
    assert ends(2, (REAL_TIME, 1.0), (NORMAL, 1.0), (NORMAL, 1.0)) == [1.0, 1.0, 2.0]
    assert ends(2, (NORMAL, 1.0), (REAL_TIME, 1.0)) == [2.0, 1.0]  # on the same core


def test_all_work_is_done_and_no_core_is_idle_while_there_is_work():
    rng, sim = Random(3), Simulation()
    host, demands, done = Host(sim, 2), [rng.expovariate(1.0) for _ in range(200)], []
    for demand_s in demands:
        host.work(NORMAL, demand_s, lambda: done.append(sim.now_s))
    sim.run(1e6)
    assert len(done) == len(demands)
    assert sum(demands) / 2 <= max(done) <= sum(demands) / 2 + max(demands)
