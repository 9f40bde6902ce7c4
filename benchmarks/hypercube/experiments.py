"""The simulated experiments: what happens from 4 to 65,536 workers, with several brokers and both ways of routing.

Each process has a core of its own, and the links are TCP, as with many hosts. Pure, but for the progress it yields.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from benchmarks.hypercube.cluster import Plan, Result, simulate
from benchmarks.hypercube.costs import Costs

WINDOW_MAX = {"trivial": 1000, "real": 400, "asleep-4ms": 400}  # commands in progress at one broker
WORKLOAD = "asleep-4ms"
BROKERS = (4, 16, 64)
LOADS = (0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95)  # of the throughput with a full window
SECONDS = 0.2  # simulated, and longer until each window has ended twice
HALT_SAMPLES_S = 1.0  # least simulated time of the runs that measure halts


class Run(NamedTuple):
    """One simulated case of an experiment."""

    experiment: str
    plan: Plan
    result: Result

    def row(self) -> dict[str, Any]:
        return {
            "experiment": self.experiment,
            "workers": 1 << self.plan.dim,
            **self.plan._asdict(),
            **self.result._asdict(),
        }


def plans(dims: Sequence[int]) -> Iterator[tuple[str, Plan]]:
    """The cases: name of the experiment, and plan."""
    for dim in dims:
        for workload in WINDOW_MAX:
            yield "one broker", _plan(dim, 1, workload=workload)
        yield "one broker, dimension-order", _plan(dim, 1, cubic=True)
        for brokers in BROKERS:
            if dim % 2 == 0 and 4 * brokers <= 1 << dim:
                yield "shared pool, lowest first", _plan(dim, brokers)
                yield "shared pool, nearest first", _plan(dim, brokers, nearest=True)
                yield "shared pool, nearest first, dimension-order", _plan(dim, brokers, nearest=True, cubic=True)
                yield "own workers", _plan(dim, brokers, shared=False)


def _plan(dim: int, brokers: int, *, workload: str = WORKLOAD, **options: bool) -> Plan:
    """Four commands in progress per worker, at most WINDOW_MAX at one broker."""
    window = max(4, min(WINDOW_MAX[workload], (4 << dim) // brokers))
    return Plan(dim=dim, workload=workload, window=window, brokers=brokers, tcp=True, **options)


def run(costs: Costs, dims: Sequence[int], seed: int) -> Iterator[Run]:
    """All experiments; yields each as it ends."""
    for name, plan in plans(dims):
        yield Run(name, plan, simulate(costs, plan, seconds=SECONDS, seed=seed))


def loads(costs: Costs, dim: int, seed: int) -> Iterator[Run]:
    """Times and halts at parts of one broker's throughput, the commands arriving at random times."""
    plan = _plan(dim, 1)
    most = simulate(costs, plan, seconds=SECONDS, seed=seed).commands_per_s
    for share in LOADS:
        open_plan = plan._replace(rate=share * most)
        yield Run("load", open_plan, simulate(costs, open_plan, seconds=max(SECONDS, HALT_SAMPLES_S), seed=seed))


def first_limit(result: Result) -> str:
    """What is saturated in a run: the part that is busy for most of the time."""
    busy = {
        "health checks and heartbeats": result.background,
        "the broker": result.broker_busy,
        "the workers": result.worker_busy,
        "a relaying node": result.relay_busy,
    }
    if busy["health checks and heartbeats"] > 0.5 * busy["the broker"] > 0.25:
        return "health checks and heartbeats"
    return max(busy, key=lambda name: busy[name])
