"""Do a recorder and an exporter beside the cluster cost throughput, or delay a halt?

    python -m benchmarks.observers [--rounds 4] [--seconds 3] [--halts 20]

Each round measures the same twice, first without and then with `rtc record` and `rtc observe` (metrics and traces; the
collector of the traces is absent). Throughput is that of trivial commands and of real sentences as far as bound, as in
`benchmarks.throughput`; the halts are those of `benchmarks.halt`, idle. On few cores the observers take processor time
from a cluster that could use all of it; so the broker's own time per command is shown too.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random

from benchmarks import halt
from benchmarks.load.client import LoadClient
from benchmarks.load.cluster import cluster
from benchmarks.load.trivial import sentence
from benchmarks.report import finish, percentile, question
from benchmarks.report import spread as latencies
from benchmarks.throughput import PLANNERS, motion, spread
from rtc.client.client import Client
from rtc.demos.own_cluster import own_cluster
from rtc.protocol.messages import WorkerKind

WARM_UP_S = 1.5
COLLECTOR = "http://127.0.0.1:9"  # the discard port: nothing answers

Case = tuple[str, bool]  # what is measured; with observers


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=3.0, help="of each throughput")
    parser.add_argument("--halts", type=int, default=20, help="of each round")
    given = parser.parse_args()
    question("observers", "throughput and halt latency without and with a recorder and an exporter beside the cluster")
    found: dict[Case, list[float]] = {}
    for number in range(1, given.rounds + 1):
        for watched in (False, True):
            for what, values in measure(given, watched, number):
                found.setdefault((what, watched), []).extend(values)
        print(f"  round {number} done", flush=True)
    finish("observers", metrics(found), rows(found))


def measure(given: argparse.Namespace, watched: bool, seed: int) -> Iterator[tuple[str, list[float]]]:
    """One half of a round: (what, figures)."""
    rate, broker_us = flood(given.seconds, watched)
    yield "trivial commands/s", [rate]
    yield "broker, us per trivial command", [broker_us]
    rate, _ = flood(given.seconds, watched, real=True)
    yield "real sentences/s", [rate]
    yield "halt, ms", halts(given.halts, watched, seed)


@contextmanager
def observers(run_dir: Path, wanted: bool) -> Iterator[None]:
    """`rtc record` and `rtc observe` beside a cluster, from the first line that each prints."""
    if not wanted:
        yield
        return
    rtc = [sys.executable, "-P", "-m", "rtc.cli.main"]
    with tempfile.TemporaryDirectory(prefix="rtc-bench-") as folder:
        record = [*rtc, "record", "-o", f"{folder}/run.mcap", "--run-dir", str(run_dir)]
        observe = [*rtc, "observe", "--prometheus", "0", "--otlp", COLLECTOR, "--run-dir", str(run_dir)]
        started = [
            subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
            for command in (record, observe)
        ]
        try:
            for process in started:
                assert process.stdout is not None
                if not process.stdout.readline():
                    raise SystemExit(f"{process.args!r} did not start")
            yield
        finally:
            for process in started:
                process.kill()
                process.wait()


def flood(for_s: float, watched: bool, *, real: bool = False) -> tuple[float, float]:
    """Commands per second, and processor time of the broker per command (us)."""
    kinds: tuple[WorkerKind, ...] = PLANNERS if real else ()
    with (
        cluster(3 if real else 2, real=kinds) as running,
        observers(running.run_dir, watched),
        LoadClient(running.settings, motion if real else sentence, 100 if real else 1000) as client,
    ):
        client.run(2 * WARM_UP_S if real else WARM_UP_S)
        client.latencies_s.clear()
        before = running.cpu_s()["broker"]
        rate = client.run(for_s)
        used_s = running.cpu_s()["broker"] - before
        ended = len(client.latencies_s)
        client.drain()
    return rate, 1e6 * used_s / ended


def halts(how_many: int, watched: bool, seed: int) -> list[float]:
    """Latencies of halts of a moving arm (ms)."""
    with own_cluster(mcm="kinematic") as run_dir, observers(run_dir, watched), Client(run_dir) as rtc:
        bench = halt.Bench(rtc, Random(seed))
        name = "with observers" if watched else "without"
        return [1e3 * latency_s for latency_s in bench.latencies_s(name, how_many, halt.nothing, each=False)]


def metrics(found: dict[Case, list[float]]) -> dict[str, float | None]:
    def ratio(what: str) -> float:
        return percentile(found[what, True], 50) / percentile(found[what, False], 50)

    return {
        "trivial_ratio": ratio("trivial commands/s"),
        "sentences_ratio": ratio("real sentences/s"),
        "broker_time_ratio": ratio("broker, us per trivial command"),
        "halt_p50_without_ms": percentile(found["halt, ms", False], 50),
        "halt_p50_with_ms": percentile(found["halt, ms", True], 50),
        "halt_p99_without_ms": percentile(found["halt, ms", False], 99),
        "halt_p99_with_ms": percentile(found["halt, ms", True], 99),
    }


def rows(found: dict[Case, list[float]]) -> Iterator[tuple[str, str]]:
    for (what, watched), values in sorted(found.items()):
        text = latencies(values, unit="ms") if what.startswith("halt") else spread(values)
        yield f"{what}, {'with' if watched else 'without'} observers", text


if __name__ == "__main__":
    main()
