"""Do a recorder and an exporter beside the cluster cost throughput, or delay a halt?

    python -m benchmarks.observers [--rounds 4] [--seconds 2] [--halts 10]

Each round measures the same twice, without and with `rtc record` and `rtc observe` (metrics and traces; the collector
of the traces is absent). Every other round begins with the observers. Each round gives a ratio, so that a slow minute
of the machine is in both of its parts. A difference is within the noise if the rounds do not agree on its sign. So is
one that is smaller than the spread of the rounds without observers. Takes about three minutes. Throughput is that of
trivial commands and of real sentences as far as bound, as in `benchmarks.throughput`; the halts are those of
`benchmarks.halt`, idle. On few cores the observers take processor time from a cluster that could use all of it. So the
broker's own time per command is shown too.
"""

from __future__ import annotations

import argparse
import statistics
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
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol.messages import WorkerKind

WARM_UP_S = 1.5
COLLECTOR = "http://127.0.0.1:9"  # the discard port: nothing answers
TRIVIAL, REAL = "trivial commands/s", "real sentences/s"
BROKER, HALT = "broker, us per trivial command", "halt, ms"

Case = tuple[str, bool]  # what is measured; with observers
Found = dict[Case, list[list[float]]]  # the figures of each round


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=2.0, help="of each throughput")
    parser.add_argument("--halts", type=int, default=10, help="of each round")
    given = parser.parse_args()
    question("observers", "throughput and halt latency without and with a recorder and an exporter beside the cluster")
    found: Found = {}
    for number in range(1, given.rounds + 1):
        for watched in (False, True) if number % 2 else (True, False):
            for what, values in measure(given, watched, number):
                found.setdefault((what, watched), []).append(values)
        print(f"  round {number} done", flush=True)
    finish("observers", metrics(found), rows(found))


def measure(given: argparse.Namespace, watched: bool, seed: int) -> Iterator[tuple[str, list[float]]]:
    """One half of a round: (what, figures)."""
    rate, broker_us = flood(given.seconds, watched)
    yield TRIVIAL, [rate]
    yield BROKER, [broker_us]
    rate, _ = flood(given.seconds, watched, real=True)
    yield REAL, [rate]
    yield HALT, halts(given.halts, watched, seed)


@contextmanager
def observers(run_dir: Path, wanted: bool) -> Iterator[None]:
    """`rtc record` and `rtc observe` beside a cluster, from the first line that each prints."""
    if not wanted:
        yield
        return
    rtc = [sys.executable, "-P", "-m", "rtc.apps.cli.main"]
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


def ratios(found: Found, what: str) -> list[float]:
    """With observers / without, of the median of each round."""
    halves = zip(found[what, True], found[what, False], strict=True)
    return [percentile(watched, 50) / percentile(alone, 50) for watched, alone in halves]


def verdict(found: Found, what: str) -> str:
    """The ratio with its spread, and whether it differs from 1 by more than the noise."""
    each = ratios(found, what)
    middle = statistics.median(each)
    alone = [percentile(values, 50) for values in found[what, False]]
    noise = (max(alone) - min(alone)) / statistics.median(alone)
    agree = min(each) > 1.0 or max(each) < 1.0
    words = "beyond the noise" if agree and abs(middle - 1.0) > noise else "within the noise"
    return f"{middle:.3f} ({min(each):.3f} to {max(each):.3f}); {words} (spread without observers {100 * noise:.1f} %)"


def metrics(found: Found) -> dict[str, float | None]:
    def halt_ms(percent: float, watched: bool) -> float:
        return percentile([value for values in found[HALT, watched] for value in values], percent)

    return {
        "trivial_ratio": statistics.median(ratios(found, TRIVIAL)),
        "sentences_ratio": statistics.median(ratios(found, REAL)),
        "broker_time_ratio": statistics.median(ratios(found, BROKER)),
        "halt_ratio": statistics.median(ratios(found, HALT)),
        "halt_p50_without_ms": halt_ms(50, False),
        "halt_p50_with_ms": halt_ms(50, True),
        "halt_p99_without_ms": halt_ms(99, False),
        "halt_p99_with_ms": halt_ms(99, True),
    }


def rows(found: Found) -> Iterator[tuple[str, str]]:
    for (what, watched), rounds in sorted(found.items()):
        values = [value for one in rounds for value in one]
        text = latencies(values, unit="ms") if what == HALT else spread(values)
        yield f"{what}, {'with' if watched else 'without'} observers", text
    for what in (TRIVIAL, REAL, BROKER, HALT):
        yield f"{what}, with / without", verdict(found, what)


if __name__ == "__main__":
    main()
