"""Compares the simulated cluster with the real one of `benchmarks.scaling`, case by case. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from benchmarks.hypercube.cluster import ARMS, Plan, Result, simulate
from benchmarks.hypercube.costs import Costs

LIMIT = 0.15  # of the error of the throughput
CELL_ARMS = 2  # of the real workload
SECONDS = 1.5


class Comparison(NamedTuple):
    """Medians of the rounds; commands per second, and ms."""

    label: str
    workload: str
    workers: int
    real_per_s: float
    real_range: tuple[float, float]
    simulated: Result
    real_waiting_ms: float
    real_latency_p99_ms: float
    real_halt_p50_ms: float | None
    real_broker_us: float  # processor time of the broker per command

    @property
    def error(self) -> float:
        """Relative error of the simulated throughput."""
        return self.simulated.commands_per_s / self.real_per_s - 1.0

    @property
    def waiting_error(self) -> float:
        """Relative error of the simulated waiting, p50."""
        return self.simulated.waiting_p50_ms / max(1e-9, self.real_waiting_ms) - 1.0

    @property
    def broker_us(self) -> float:
        """Simulated processor time of the broker per command."""
        return self.simulated.broker_us

    def line(self) -> str:
        low, high = self.real_range
        real = f"{self.real_per_s:7.0f} ({low:.0f} to {high:.0f})"
        waiting = f"{self.real_waiting_ms:6.1f} {self.simulated.waiting_p50_ms:6.1f} {100 * self.waiting_error:+5.0f} %"
        halt = "" if self.real_halt_p50_ms is None else f"{self.real_halt_p50_ms:.2f} {self.simulated.halt_p50_ms:.2f}"
        return (
            f"{self.label:<26} {real:<26} {self.simulated.commands_per_s:7.0f} {100 * self.error:+5.0f} %   "
            f"{waiting}   {halt:<10}  {self.real_broker_us:5.0f} {self.broker_us:5.0f}"
        )


HEADER = (
    f"{'':<26} {'commands/s: real':<26} simulated, error  waiting p50, ms: real, simulated, error"
    "  halt p50, ms: both  broker, us: both"
)


def plan_of(row: dict[str, Any], cores: int) -> Plan:
    """The plan that corresponds to a case of `benchmarks.scaling`."""
    real = row["workload"] == "real"
    arms = CELL_ARMS if real else ARMS
    return Plan(dim=row["dim"], workload=row["workload"], window=row["window"], cores=cores, arms=arms, beside=real)


def compare(costs: Costs, data: Sequence[dict[str, Any]], cores: int, seed: int) -> Iterator[Comparison]:
    """Simulate each case with forked workers."""
    for row in data:
        if row["engine"] == "process":
            result = simulate(costs, plan_of(row, cores), seconds=SECONDS, seed=seed)
            middle, low, high = row["commands_per_s"]
            yield Comparison(
                label=f"{row['workload']}, {row['workers']} workers",
                workload=row["workload"],
                workers=row["workers"],
                real_per_s=middle,
                real_range=(low, high),
                simulated=result,
                real_waiting_ms=row["waiting_p50_ms"][0],
                real_latency_p99_ms=row["latency_p99_ms"][0],
                real_halt_p50_ms=row["halt_p50_ms"][0] if "halt_p50_ms" in row else None,
                real_broker_us=row["broker_us"][0],
            )
