"""The simulated experiments: what happens from 4 to 65,536 workers, with several brokers and both ways of routing.

Each process has a core of its own, and the links are TCP, as with many hosts. Pure, but for the progress it yields.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from benchmarks.hypercube.cluster import Plan, Result, simulate
from benchmarks.hypercube.costs import Costs

WINDOW_MOST = 1000  # commands in progress at one broker, as in `benchmarks.scaling`
WORKLOAD = "asleep-4ms"
BROKERS = (1, 4, 16, 64)
LOADS = (0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95)  # of the throughput with a full window
SECONDS = 0.4
EVENTS_FOR = 1_000_000  # the simulated time is shortened so that a run has about so many events
EVENTS_PER_COMMAND = 30
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


def window(dim: int, brokers: int) -> int:
    """Commands in progress at each broker: four per worker in total, at most WINDOW_MOST."""
    return max(4, min(WINDOW_MOST, (4 << dim) // brokers))


def plans(dims: Sequence[int]) -> Iterator[tuple[str, Plan]]:
    for dim in dims:
        for workload in ("trivial", "real", WORKLOAD):
            yield "one broker", _plan(dim, workload=workload)
        yield "one broker, dimension-order", _plan(dim, cubic=True)
        for brokers in BROKERS[1:]:
            if dim % 2 == 0 and 4 * brokers <= 1 << dim:
                yield "shared pool", _plan(dim, brokers=brokers)
                yield "own workers", _plan(dim, brokers=brokers, shared=False)
                yield "shared pool, dimension-order", _plan(dim, brokers=brokers, cubic=True)


def _plan(dim: int, *, workload: str = WORKLOAD, brokers: int = 1, shared: bool = True, cubic: bool = False) -> Plan:
    return Plan(
        dim=dim,
        workload=workload,
        window=window(dim, brokers),
        brokers=brokers,
        shared=shared,
        cubic=cubic,
        tcp=True,
    )


def run(costs: Costs, dims: Sequence[int], seed: int) -> Iterator[Run]:
    """All experiments; yields each as it ends."""
    for name, plan in plans(dims):
        yield Run(name, plan, simulate(costs, plan, seconds=_seconds(plan), seed=seed))


def loads(costs: Costs, dim: int, seed: int) -> Iterator[Run]:
    """Times and halts at parts of one broker's throughput, the commands arriving at random times."""
    plan = _plan(dim)
    most = simulate(costs, plan, seconds=SECONDS, seed=seed).commands_per_s
    for share in LOADS:
        open_plan = plan._replace(rate=share * most)
        yield Run("load", open_plan, simulate(costs, open_plan, seconds=max(SECONDS, HALT_SAMPLES_S), seed=seed))


def _seconds(plan: Plan) -> float:
    """Simulated time: SECONDS, or less for a plan with very many events."""
    per_s = min(plan.brokers * 12_000.0, (1 << plan.dim) / 0.016) if plan.workload == WORKLOAD else 12_000.0
    events_per_s = per_s * (EVENTS_PER_COMMAND + (4 * plan.dim if plan.cubic else 0))
    return max(0.1, min(SECONDS, EVENTS_FOR / events_per_s))


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
