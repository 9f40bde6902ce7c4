"""The model of the cluster against theory: saturation, Little's law, hop counts; and its rules against the broker's."""

from __future__ import annotations

import math
from itertools import pairwise
from random import Random

import msgspec
import pytest

from benchmarks.hypercube.cluster import Plan, simulate
from benchmarks.hypercube.costs import Costs, Lengthy, PeerCosts, WorkerCosts
from benchmarks.hypercube.registry import Registry
from benchmarks.hypercube.routing import between, homes, hops
from broker.decisions.effects import DispatchJob
from broker.dispatch.worker_registry import WorkerRegistry
from rtc.protocol.messages import WorkerKind

STAGES = ("accept", "parsed", "elaborated", "bound", "reported", "analyzed")
KINDS = tuple(WorkerKind)


def costs(turn=0.0, event=1e-5, service=0.0, link=1e-5, relay=1e-5, **others):
    """Costs without spread."""
    free = {"turn": turn, "wake_up": 0.0, "message_in": 0.0, "message_out": 0.0}
    worker = WorkerCosts(per_message=1e-6, per_item=1e-6, io_per_message=0.0, service=[service])
    load = "asleep-4ms" if service else "trivial"
    given = {
        "broker": free | dict.fromkeys(STAGES, event),
        "lengthy": {},
        "snapshot_per_event": 0.0,
        "ratios": [1.0],
        "io_per_turn": 0.0,
        "io_per_message": 0.0,
        "io_wake_up": 0.0,
        "heartbeat": 0.0,
        "assign_per_worker": 0.0,
        "check_per_worker": 0.0,
        "workers": {load: [worker] * 4},
        "subsystem": PeerCosts(1e-6, 1e-6, 0.0),
        "client": PeerCosts(1e-6, 1e-6, 0.0),
        "links": {"ipc": [link], "tcp": [link]},
        "relay": relay,
    }
    return Costs(**given | others)


def run(costs, seconds=0.4, seed=1, **plan):
    return simulate(costs, Plan(**plan), seconds=seconds, seed=seed)


def erlang_c(servers: int, load: float) -> float:
    """Probability that a customer waits in an M/M/c queue; `load` = arrival rate times mean service time."""
    last = load**servers / math.factorial(servers) * servers / (servers - load)
    return last / (sum(load**k / math.factorial(k) for k in range(servers)) + last)


@pytest.mark.parametrize(("dim", "load"), [(2, 0.6), (3, 1.4)])
def test_waiting_of_random_arrivals_is_that_of_four_mmc_queues_in_series(dim, load):
    """Each kind is an M/M/c queue: the departures of one are random arrivals at the next (Burke's theorem)."""
    mean_s = 0.02  # so long that a worker gets one job at a time
    exponential = [-mean_s * math.log(1.0 - (n + 0.5) / 1000) for n in range(1000)]
    worker = WorkerCosts(per_message=0.0, per_item=0.0, io_per_message=0.0, service=exponential)
    random = costs(event=0.0, link=0.0, workers={"asleep-4ms": [worker] * 4})
    found = run(random, seconds=240.0 / load, dim=dim, workload="asleep-4ms", rate=load / mean_s, seed=3)
    expected_s = 4 * mean_s * erlang_c((1 << dim) // 4, load) / ((1 << dim) // 4 - load)
    assert found.waiting_mean_ms == pytest.approx(1e3 * expected_s, rel=0.1)


def test_a_saturated_broker_passes_one_command_in_its_time_for_six_events():
    found = run(costs(event=2e-5), dim=4, workload="trivial")
    assert found.commands_per_s == pytest.approx(1.0 / (6 * 2e-5), rel=0.03)
    assert found.broker_busy == pytest.approx(1.0, abs=0.02)


def test_slow_workers_limit_the_throughput_to_their_number_over_their_time():
    found = run(costs(service=0.004), seconds=2.0, dim=4, workload="asleep-4ms", window=64)
    assert found.commands_per_s == pytest.approx(4 / 0.004, rel=0.03)
    assert found.worker_busy == pytest.approx(1.0, abs=0.03)


def test_one_command_alone_takes_its_services_its_events_and_its_links():
    found = run(costs(service=0.004, link=1e-4), dim=2, workload="asleep-4ms", window=1)
    alone_s = 4 * 0.004 + 6e-5 + 12 * 1e-4
    assert found.latency_p50_ms == pytest.approx(1e3 * alone_s, rel=0.01)


def test_littles_law():
    found = run(costs(service=0.004), seconds=2.0, dim=3, workload="asleep-4ms", window=40)
    assert found.commands_per_s * found.latency_p50_ms / 1e3 == pytest.approx(40, rel=0.05)


def test_two_cores_do_the_work_of_all_processes():
    """The broker has one of two cores; the jobs of 1 ms of processor time share the other, and what it leaves."""
    busy = WorkerCosts(per_message=0.0, per_item=0.0, io_per_message=0.0, service=[0.001])
    found = run(costs(workers={"real": [busy] * 4}), seconds=2.0, dim=4, workload="real", window=64, cores=2)
    assert found.commands_per_s == pytest.approx(2.0 / (4 * 0.001 + 6e-5 + 8e-6), rel=0.03)


def test_commands_of_one_arm_are_executed_one_after_the_other():
    slow = costs(service=0.004)
    one = run(slow, seconds=2.0, dim=4, workload="asleep-4ms", window=16, arms=1)
    assert one.commands_per_s == pytest.approx(1.0 / (2 * 0.004), rel=0.05)  # bind, execute, analyze
    two = run(slow, seconds=2.0, dim=4, workload="asleep-4ms", window=16, arms=2)
    assert two.commands_per_s == pytest.approx(2 * one.commands_per_s, rel=0.05)


def test_a_step_is_bound_again_if_another_arm_of_its_space_has_begun_to_move_meanwhile():
    slow, plan = costs(service=0.004), {"seconds": 2.0, "dim": 4, "workload": "asleep-4ms", "window": 16}
    apart = run(slow, arms=2, **plan)
    alone = run(slow, arms=1, beside=True, **plan)
    beside = run(slow, arms=2, beside=True, **plan)
    assert apart.broker_us == pytest.approx(60.0, rel=0.02)  # six events
    assert alone.broker_us == pytest.approx(60.0, rel=0.02)
    assert 61.0 < beside.broker_us < 80.0
    assert beside.commands_per_s < apart.commands_per_s


def test_a_job_beside_a_motion_takes_its_own_time_and_its_events_their_payload():
    plan = {"seconds": 2.0, "dim": 4, "workload": "asleep-4ms", "window": 16, "arms": 2, "beside": True}
    usual = costs(service=0.004)
    longer = WorkerCosts(0.0, 0.0, 0.0, [0.004], conditions={"beside": [0.008], "beside, new way": [0.008]})
    slower = run(costs(service=0.004, workers={"asleep-4ms": [longer] * 4}), **plan)
    assert slower.commands_per_s < 0.9 * run(usual, **plan).commands_per_s
    payload = {"alone": {}, "beside": {"rebound": 1e-3}}
    more = run(usual._replace(lengthy={"asleep-4ms": Lengthy(0.0, 0.0, usual.subsystem, payload)}), **plan)
    assert more.broker_us > run(usual, **plan).broker_us + 50.0


def test_the_cost_of_many_workers_is_paid_by_each_broker_that_shares_them():
    scanned = costs(service=0.004, heartbeat=1e-5)
    few = run(scanned, dim=4, workload="asleep-4ms", window=8)
    many = run(scanned, dim=10, workload="asleep-4ms", window=8)
    assert few.background == pytest.approx(2 * 16 * 1e-5, rel=0.3)
    assert many.background == pytest.approx(2 * 1024 * 1e-5, rel=0.3)


def test_a_halt_waits_for_the_turn_in_progress_only():
    found = run(costs(event=1e-4), seconds=2.0, dim=3, workload="trivial")
    longest_turn_s = (64 + 48 + 64) * 1e-4
    assert found.halt_p99_ms < 1e3 * (longest_turn_s + 5e-3)
    assert found.latency_p50_ms > 5 * found.halt_p99_ms


def test_the_same_seed_gives_the_same_result_and_another_seed_another():
    spread = costs(service=0.004)._replace(ratios=[0.5, 1.0, 1.5])
    first, again, other = (
        run(spread, seed=seed, dim=4, workload="asleep-4ms", window=32, cores=2, rate=500.0) for seed in (7, 7, 8)
    )
    assert first == again
    assert first != other


def test_offered_commands_below_saturation_all_pass():
    found = run(costs(service=0.004), seconds=2.0, dim=5, workload="asleep-4ms", rate=500.0)
    assert found.commands_per_s == pytest.approx(500, rel=0.1)
    assert found.backlog < 60


# --- routing ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dim", [0, 1, 2, 4, 10])
def test_dimension_order_routing_takes_half_the_dimension_on_average(dim):
    nodes = range(1 << dim)
    assert sum(hops(0, node) for node in nodes) / len(nodes) == dim / 2


def test_a_way_corrects_one_bit_per_hop_the_lowest_first():
    assert [*between(0b000, 0b111)] == [0b001, 0b011]
    assert [*between(0b101, 0b101)] == []
    assert [*between(0b101, 0b100)] == []
    rng = Random(1)
    for _ in range(100):
        source, target = rng.randrange(1024), rng.randrange(1024)
        way = [source, *between(source, target), target]
        if source != target:
            assert [hops(a, b) for a, b in pairwise(way)] == [1] * hops(source, target)


def test_homes_of_brokers_are_distinct_nodes():
    assert homes(1, 4) == [0]
    assert len(set(homes(5, 4))) == 5
    with pytest.raises(ValueError, match="17 brokers"):
        homes(17, 4)


def test_each_intermediate_node_adds_its_time_and_a_link():
    plan = {"dim": 6, "workload": "asleep-4ms", "window": 1, "seconds": 4.0}
    direct, cubic = (run(costs(service=0.004, relay=1e-3), cubic=cubic, **plan) for cubic in (False, True))
    assert direct.relay_busy == 0.0
    # The only broker is at node 0. With one command in progress, node 0 to 3 do all jobs: 1 and 2 are one hop away,
    # and node 3, the analyzer, is two: one relay of 1 ms and one more link, there and back.
    assert cubic.latency_p50_ms - direct.latency_p50_ms == pytest.approx(2 * (1.0 + 0.01), rel=0.02)


# --- the assignment of jobs -----------------------------------------------------------------------------


def test_jobs_go_to_the_same_workers_as_with_the_brokers_own_registry():
    rng, workers = Random(5), 12
    real, model = WorkerRegistry(), Registry([(node, f"{KINDS[node % 4]}@{node}") for node in range(workers)])
    for node in range(workers):
        real.register(f"{KINDS[node % 4]}@{node}", node, KINDS[node % 4], 1, 0.0)
    in_progress = []
    number = compared = 0
    for step in range(3000):
        for kind in rng.choices(range(4), k=rng.randrange(4)):
            number += 1
            name = f"C-{number}/1"
            job = DispatchJob(
                job=name,
                attempt=1,
                kind=KINDS[kind],
                queue=KINDS[kind],
                program="",
                cell="",
                input=msgspec.Raw(b""),
                client="one",
            )
            real.submit(job, 0.0)
            model.queues[kind].append(name)
        expected = [(worker, [job.job for job in jobs]) for worker, jobs in real.assign(0.0)]
        found = list(model.assign())
        assert [(slot.worker, jobs) for _, slot, jobs in found] == expected
        compared += len(found)
        in_progress += [(kind, slot, job) for kind, slot, jobs in found for job in jobs]
        slow = step > 1500
        for _ in range(min(len(in_progress), rng.randrange(5))):
            kind, slot, job = in_progress.pop(0)
            took_s = rng.uniform(0.003, 0.008) if slow else rng.uniform(1e-5, 1e-3)
            assert real.answered(slot.worker, job, 1, took_s, 0.0)
            model.answered(kind, slot, took_s)
    assert compared > 1000
