"""The benchmark of scaling: a short run with sleeping workers, and its summary."""

from __future__ import annotations

import pytest

from benchmarks.hypercube.check import Comparison, plan_of
from benchmarks.hypercube.cluster import Result
from benchmarks.scaling import Case, measure, summary


@pytest.mark.slow
@pytest.mark.untimed
def test_a_measured_case_has_its_throughput_its_waiting_and_its_halts():
    found = measure(Case("asleep-4ms", "process", 2), 0.5)
    assert 0 < found["commands_per_s"] < 1.2 / 0.004  # the commands of the warm-up may end in the measurement
    assert found["service_ms"] >= 4 * 4
    assert found["latency_p99_ms"] >= found["latency_p50_ms"] >= found["service_ms"]
    assert found["halt_p99_ms"] >= found["halt_p50_ms"] > 0
    assert found["all_processes_us"] > found["broker_us"] > 0


def test_a_summary_has_median_and_range_of_the_rounds_and_the_plan_of_its_case():
    case = Case("asleep-4ms", "process", 3)
    (row,) = summary({case: [{"commands_per_s": 3.0}, {"commands_per_s": 1.0}, {"commands_per_s": 2.0}]})
    assert row["commands_per_s"] == [2.0, 1.0, 3.0]
    plan = plan_of(row, cores=2)
    assert (plan.dim, plan.workload, plan.window, plan.cores) == (3, "asleep-4ms", 32, 2)


def test_errors_are_relative_to_the_real_cluster():
    result = Result(*[0.0] * len(Result._fields))._replace(commands_per_s=90.0, waiting_p50_ms=3.0)
    one = Comparison("a case", "trivial", 4, 100.0, (90.0, 110.0), result, 2.0, 5.0, None, 9e3)
    assert one.error == pytest.approx(-0.1)
    assert one.waiting_error == pytest.approx(0.5)
