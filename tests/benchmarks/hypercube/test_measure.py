"""The microbenchmarks: fits find the costs that made the samples, and the real processes can be timed."""

from __future__ import annotations

from random import Random

import pytest

from benchmarks.hypercube import broker_costs, payload_costs, planner_costs, process_costs
from benchmarks.hypercube.costs import _woken
from benchmarks.hypercube.fit import fitted, medians, middle, quantiles, ratios
from rtc.protocol.messages import WorkerKind


def test_a_fit_finds_the_costs_that_made_the_samples():
    rng, costs = Random(1), [100.0, 5.0, 0.0]
    rows = [(1.0, float(rng.randrange(50)), float(rng.randrange(50))) for _ in range(200)]
    times = [sum(c * x for c, x in zip(costs, row, strict=True)) for row in rows]
    assert fitted(rows, times) == pytest.approx(costs, abs=1e-6)
    assert ratios(rows, times, costs) == pytest.approx([1.0] * 100)


def test_a_cost_is_never_negative():
    rows = [(1.0, 1.0), (1.0, 2.0), (1.0, 3.0)]
    assert fitted(rows, [3.0, 2.0, 1.0])[1] == 0.0
    with pytest.raises(ValueError, match="no samples"):
        fitted([], [])


def test_a_disturbed_sample_does_not_move_the_median_of_its_group():
    rows = [(1.0, 1.0)] * 3 + [(1.0, 2.0)]
    assert medians(rows, [5.0, 900.0, 4.0, 7.0]) == ([(1.0, 1.0), (1.0, 2.0)], [5.0, 7.0])


def test_a_distribution_keeps_the_mean_and_the_order_of_its_samples():
    samples = [Random(2).expovariate(1.0) for _ in range(1000)]
    kept = quantiles(samples)
    assert len(kept) == 100
    assert kept == sorted(kept)
    assert sum(kept) / 100 == pytest.approx(sum(samples) / 1000)
    assert quantiles([3.0, 1.0]) == [1.0, 3.0]


def test_the_middle_of_rounds_is_the_median_of_each_number():
    rounds = [
        {"turn": 3.0, "kinds": [{"cost": 1.0}, {"cost": 9.0}]},
        {"turn": 1.0, "kinds": [{"cost": 5.0}, {"cost": 7.0}]},
    ]
    assert middle([*rounds, rounds[0]]) == rounds[0]
    assert middle([[1.0, 2.0], [3.0, 8.0], [2.0, 4.0, 9.0]]) == [2.0, 4.0]


def test_a_preempted_job_does_not_count_as_a_long_one():
    assert planner_costs._undisturbed([1.0, 1.2, 1.5, 9.0, 40.0]) == [1.0, 1.2, 1.5, 3.0, 3.0]


def test_a_woken_process_costs_what_a_lone_command_took_more():
    woken = _woken({"per_message": 10.0, "per_item": 2.0, "io_per_message": 3.0}, (52.0, 13.0), 2)
    assert (woken["wake_up"], woken["io_wake_up"]) == (15.0, 3.5)
    assert _woken({"per_message": 10.0, "per_item": 2.0, "io_per_message": 3.0}, (1.0, 1.0), 1)["wake_up"] == 0.0


@pytest.mark.slow
def test_each_stage_of_the_real_broker_is_timed_by_its_number_of_events():
    with broker_costs.bench(2) as broker:
        for _ in range(broker_costs.SETTLED):
            list(broker.pass_through(2, broker_costs.QUICK_S))
        turns = list(broker.pass_through(5, broker_costs.QUICK_S))
        mixed = list(broker.take_turns((3, 2), broker_costs.QUICK_S))
    stages = len(broker_costs.STAGES)
    assert {sum(turn.features[-stages:]) for turn in mixed} == {3.0, 2.0}  # a late turn is not given
    assert len(mixed) <= 2 * stages
    assert all(sum(turn.features[-stages:]) == 5 and turn.main_s > 0 for turn in turns)
    assert all(turn.features[0] == 1.0 for turn in turns)


@pytest.mark.slow
def test_turns_with_the_messages_of_real_planners_are_timed_alone_and_beside_a_motion():
    stages = set(broker_costs.STAGES)
    found = payload_costs._real(2)
    assert {event for event, _ in found["alone"]} == stages
    assert {event for event, _ in found["beside"]} == {*stages, "rebound"}


@pytest.mark.slow
def test_a_sleeping_job_takes_its_time_and_little_of_the_processor():
    costs = process_costs.worker(WorkerKind.PARSER, process_costs.inputs()[WorkerKind.PARSER], 0.02, 5)
    assert min(costs["service"]) >= 0.02
    assert 0 < costs["per_message"] < 0.02


@pytest.mark.slow
@pytest.mark.untimed
def test_a_link_and_a_relay_take_time():
    assert all(delay_s > 0 for delay_s in process_costs.link("ipc", 20))
    assert process_costs.relay(2)["main"] > 0
