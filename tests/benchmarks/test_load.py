"""A real broker with real worker loops under load: every command ends, and the journal has it."""

from __future__ import annotations

from statistics import median

import pytest

from benchmarks.load.client import LoadClient
from benchmarks.load.cluster import cluster
from benchmarks.load.trivial import sentence
from benchmarks.peers import chain, raw_pyzmq
from benchmarks.soak import median_mb, run
from benchmarks.throughput import Figures, Run
from broker.persistence.journal import Journal
from rtc.client.client import Client
from rtc.protocol.outcomes import OutcomeKind


@pytest.mark.slow
@pytest.mark.untimed
def test_many_commands_at_once_all_succeed_and_are_on_record():
    with cluster(2) as running:
        with LoadClient(running.settings, sentence, window=50) as client:
            samples = run(running, client, 600)
            status = client.status()
        assert client.outcomes == {OutcomeKind.SUCCEEDED: 600}
        assert samples[-1][0] == 600
        assert all(megabytes > 1 for _, megabytes, _ in samples)
        assert status.commands_live == 0
        with Client(running.run_dir) as rtc:
            record = rtc.trace("C-300")
        assert [note.phase.value for note in record.notes][::6] == ["parsing", "ended"]
        journal = Journal.read_only(running.run_dir / "journal.db")
        assert journal.record("C-1") is not None
        assert sum(running.cpu_s().values()) > 0


@pytest.mark.slow
@pytest.mark.untimed
def test_a_peer_does_the_same_chain():
    meters = []

    def start():
        meters.append(chain.Meter(0.0, 0.2))
        return meters[0]

    raw_pyzmq.measure(chain.SIZES, start)
    assert meters[0].rate > 0


def test_memory_is_the_median_of_a_tenth_of_the_commands():
    samples = [(0, 40.0, 0.0), (50, 50.0, 0.0), (120, 60.0, 0.0), (150, 90.0, 0.0), (180, 61.0, 0.0), (950, 62.0, 0.0)]
    assert [median_mb(samples, tenth, 1000) for tenth in (0, 1, 9)] == [45.0, 61.0, 62.0]


def test_a_peer_that_is_not_there_says_so():
    assert "failed" in str(chain.ask("no_such_peer", [1, 1], 0.0, 0.1))


def test_ratios_are_of_one_round_and_a_missing_peer_is_none():
    def of(rate):
        return Run(commands_per_s=rate, turn_p50_ms=1.0, turn_p99_ms=2.0, latency_p50_ms=3.0, cpu_us={"broker": 200.0})

    found = Figures(floods={2: [of(100.0), of(300.0)], 3: [of(1.0)]}, saturated=[0.5], sentences=[4.0])
    found.peers["vs_ray"] = [10.0, 10.0]
    found.missing["vs_dask"] = "No module named 'distributed'"
    metrics = found.metrics()
    assert metrics["vs_ray"] == median([10.0, 30.0])
    assert metrics["vs_dask"] is None
    assert metrics["decision_p99_ms"] == 0.5
    rows = dict(found.rows())
    assert "distributed" in rows["Dask distributed"]
    assert rows["ours, 8 workers"].startswith("1 ")
