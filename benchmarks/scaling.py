"""How do throughput, waiting and halts change with the number of workers, of processes and of Ray actors?

    python -m benchmarks.scaling [--dims 2 3 4 5] [--rounds 3] [--seconds 3] [--engines process ray]

A real cluster per measurement: broker, journal, world database and 2^dim workers; all on this machine. Workloads:

trivial      the workers' functions do nothing: the cost of the RTC itself
asleep-1ms   each job sleeps for 1 ms (4 ms): it takes time but no processor. On a machine with few cores this is the
asleep-4ms   only way to see whether more workers give more throughput
real         parser, elaborator and binder are real, as far as a bound motion of two arms, without motion

A fixed number of commands is in progress (the window). Each round measures every case once, engine by engine, so that a
busy machine affects all. Waiting is the time of a command minus the mean service times of its four jobs. A halt goes
through the broker to the subsystem; its latency ends with the receipt there. The results are the input of
`python -m benchmarks.hypercube --check`.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from statistics import mean, median
from typing import Any, NamedTuple

from benchmarks.load.client import LoadClient
from benchmarks.load.cluster import cluster
from benchmarks.load.trivial import PERFORMERS, performer, sentence
from benchmarks.report import RESULTS, finish, percentile, question
from benchmarks.throughput import PLANNERS, motion
from rtc.protocol.messages import WorkerKind, WorkerRow
from rtc.protocol.outcomes import OutcomeKind

WARM_UP_S = 1.0
JOIN_LIMIT_S = 60.0  # time limit for all workers to register
# Performers with commands, twice as many as are in progress: none waits for another's. The last one is for halts.
LOADED = PERFORMERS - 1
IDLE_PERFORMER = performer(LOADED)
ENGINES = {"process": "forked workers", "ray": "Ray actors"}


class Workload(NamedTuple):
    window: Callable[[int], int]  # dimension of the cube -> commands in progress
    text: Callable[[int], str]
    asleep_s: float = 0.0
    real: tuple[WorkerKind, ...] = ()


def _loaded(n: int) -> str:
    return sentence(n % LOADED)


WORKLOADS = {
    "trivial": Workload(lambda dim: 1000, _loaded),
    "asleep-1ms": Workload(lambda dim: 4 << dim, _loaded, asleep_s=0.001),
    "asleep-4ms": Workload(lambda dim: 4 << dim, _loaded, asleep_s=0.004),
    "real": Workload(lambda dim: 16, motion, real=PLANNERS),
}


class Case(NamedTuple):
    workload: str
    engine: str
    dim: int

    @property
    def label(self) -> str:
        return f"{self.workload}, {1 << self.dim} {ENGINES[self.engine]}"


Measurement = dict[str, float]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dims", type=int, nargs="+", default=[2, 3, 4, 5], help="of the cube: 2^dim workers")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=3.0, help="of each measurement")
    parser.add_argument("--engines", nargs="+", choices=tuple(ENGINES), default=list(ENGINES))
    parser.add_argument("--workloads", nargs="+", choices=tuple(WORKLOADS), default=list(WORKLOADS))
    given = parser.parse_args()
    question("scaling", "throughput, waiting and halts with 2^d workers: processes beside Ray actors")
    cases = [Case(w, engine, dim) for w in given.workloads for dim in given.dims for engine in given.engines]
    found: dict[Case, list[Measurement]] = {}
    for number in range(1, given.rounds + 1):
        for case in cases:
            try:
                one = measure(case, given.seconds)
            except ImportError as error:
                print(f"  {case.label}: left out, {error}", flush=True)
                continue
            found.setdefault(case, []).append(one)
            print(f"  round {number}: {case.label}: {_line(one)}", flush=True)
    data = summary(found)
    draw(data, RESULTS / "scaling.png")
    finish("scaling", _metrics(data), _rows(data), data=data)


def measure(case: Case, for_s: float) -> Measurement:
    """Start, warm up, measure and end one cluster. Times in ms, processor times in us per command."""
    load = WORKLOADS[case.workload]
    options: dict[str, Any] = {"asleep_s": load.asleep_s, "real": load.real, "engine": case.engine}
    with (
        cluster(case.dim, **options) as running,
        LoadClient(running.settings, load.text, load.window(case.dim)) as client,
    ):
        _wait_for_workers(client, 1 << case.dim)
        halter = None if load.real else _halter(running.run_dir, for_s)
        client.run(2 * WARM_UP_S if load.real else WARM_UP_S)
        client.latencies_s.clear()
        if halter is not None:
            _begin(halter)
        before = running.cpu_s()
        rate = client.run(for_s)
        after = running.cpu_s()
        latencies_ms = [1e3 * latency_s for latency_s in client.latencies_s]
        client.drain()
        service_ms = _service_ms(client.status().workers)
        halts_ms = _halts_ms(halter)
        if set(client.outcomes) != {OutcomeKind.SUCCEEDED}:
            raise SystemExit(f"{case.label}: not every command succeeded: {dict(client.outcomes)}")
    p50, p99 = (percentile(latencies_ms, percent) for percent in (50, 99))
    used_us = {name: 1e6 * (after[name] - before[name]) / len(latencies_ms) for name in after}
    return {
        "commands_per_s": rate,
        "latency_p50_ms": p50,
        "latency_p99_ms": p99,
        "service_ms": service_ms,
        "waiting_p50_ms": max(0.0, p50 - service_ms),
        **({"halt_p50_ms": percentile(halts_ms, 50), "halt_p99_ms": percentile(halts_ms, 99)} if halts_ms else {}),
        "broker_us": used_us["broker"],
        "broker_core_percent": 100.0 * (after["broker"] - before["broker"]) / for_s,
        "all_processes_us": sum(used_us.values()),
    }


def _wait_for_workers(client: LoadClient, how_many: int) -> None:
    limit_s = time.monotonic() + JOIN_LIMIT_S
    while len(client.status().workers) < how_many:
        if time.monotonic() > limit_s:
            raise SystemExit(f"not all of {how_many} workers have registered within {JOIN_LIMIT_S:g} s")
        time.sleep(0.05)


def _service_ms(workers: Iterable[WorkerRow]) -> float:
    """Sum over the kinds of the mean service time (ms)."""
    by_kind: dict[str, list[float]] = {}
    for worker in workers:
        by_kind.setdefault(worker.kind, []).append(worker.mean_ms or 0.0)
    return sum(mean(times) for times in by_kind.values())


def _halter(run_dir: Path, for_s: float) -> subprocess.Popen[str]:
    """A process that is ready to send halts; `_begin` lets it begin."""
    command = [sys.executable, "-m", "benchmarks.load.halter", "--run-dir", str(run_dir), "--scope", IDLE_PERFORMER]
    command += ["--for-s", str(for_s)]
    halter = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert halter.stdout is not None
    if halter.stdout.readline() != "ready\n":
        raise SystemExit("the process that sends halts has not started")
    return halter


def _begin(halter: subprocess.Popen[str]) -> None:
    assert halter.stdin is not None
    halter.stdin.write("\n")
    halter.stdin.flush()


def _halts_ms(halter: subprocess.Popen[str] | None) -> list[float]:
    if halter is None:
        return []
    out, _ = halter.communicate()
    if halter.returncode:
        raise SystemExit("the process that sends halts has failed")
    return [1e3 * latency_s for latency_s in json.loads(out)]


def summary(found: dict[Case, list[Measurement]]) -> list[dict[str, Any]]:
    """One entry per case: of each figure the median, the least and the greatest of the rounds."""
    return [
        {
            **case._asdict(),
            "workers": 1 << case.dim,
            "window": WORKLOADS[case.workload].window(case.dim),
            "rounds": len(runs),
            **{name: [median(values), min(values), max(values)] for name, values in _columns(runs)},
        }
        for case, runs in found.items()
    ]


def _columns(runs: list[Measurement]) -> Iterator[tuple[str, list[float]]]:
    for name in runs[0]:
        yield name, [run[name] for run in runs]


def _line(one: Measurement) -> str:
    halt = f", halt p99 {one['halt_p99_ms']:.2f} ms" if "halt_p99_ms" in one else ""
    return (
        f"{one['commands_per_s']:.0f}/s, p50 {one['latency_p50_ms']:.1f} p99 {one['latency_p99_ms']:.1f} ms, "
        f"waiting {one['waiting_p50_ms']:.1f} ms{halt}, broker {one['broker_core_percent']:.0f} % of a core"
    )


def _metrics(data: list[dict[str, Any]]) -> dict[str, float | None]:
    return {f"{row['workload']}_{row['engine']}_{row['workers']}_per_s": row["commands_per_s"][0] for row in data}


def _rows(data: list[dict[str, Any]]) -> Iterator[tuple[str, str]]:
    for row in data:
        label = Case(row["workload"], row["engine"], row["dim"]).label
        shown = [
            f"{_spread(row, 'commands_per_s', 0)}/s",
            f"p50 {_spread(row, 'latency_p50_ms', 1)} ms",
            f"p99 {_spread(row, 'latency_p99_ms', 1)} ms",
            f"waiting {_spread(row, 'waiting_p50_ms', 1)} ms",
            *([f"halt p99 {_spread(row, 'halt_p99_ms', 2)} ms"] if "halt_p99_ms" in row else []),
            f"broker {_spread(row, 'broker_us', 0)} us, all {_spread(row, 'all_processes_us', 0)} us per command",
        ]
        yield label, "; ".join(shown)


def _spread(row: dict[str, Any], name: str, digits: int) -> str:
    middle, least, most = row[name]
    return f"{middle:.{digits}f} ({least:.{digits}f} to {most:.{digits}f})"


PANELS = {
    "commands_per_s": "commands per second",
    "latency_p50_ms": "time of a command, p50 (ms)",
    "waiting_p50_ms": "waiting in queues, p50 (ms)",
    "halt_p99_ms": "halt, until its receipt, p99 (ms)",
}


def draw(data: list[dict[str, Any]], file: Path) -> None:
    """One panel per figure; skipped without matplotlib."""
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
    except ImportError:
        return
    figure, grid = pyplot.subplots(2, 2, figsize=(11, 8))
    series = list(dict.fromkeys((row["workload"], row["engine"]) for row in data))
    colours = {workload: f"C{n}" for n, workload in enumerate(dict.fromkeys(w for w, _ in series))}
    for axes, (name, title) in zip(grid.flat, PANELS.items(), strict=True):
        for workload, engine in series:
            rows = [r for r in data if (r["workload"], r["engine"]) == (workload, engine) and name in r]
            if not rows:
                continue
            middle, least, most = zip(*(row[name] for row in rows), strict=True)
            errors = [
                [m - low for m, low in zip(middle, least, strict=True)],
                [high - m for m, high in zip(middle, most, strict=True)],
            ]
            axes.errorbar(
                [row["workers"] for row in rows],
                middle,
                yerr=errors,
                marker="os"[engine == "ray"],
                linestyle=("-", "--")[engine == "ray"],
                color=colours[workload],
                capsize=3,
                label=f"{workload}, {ENGINES[engine]}",
            )
        axes.set_xscale("log", base=2)
        axes.set_yscale("log")
        workers = sorted({row["workers"] for row in data})
        axes.set_xticks(workers, [str(n) for n in workers])
        axes.set_xlabel("workers")
        axes.set_ylabel(title)
        axes.grid(alpha=0.3)
    lines, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="lower center", ncols=4, fontsize=9, handlelength=3)
    figure.suptitle("One broker, 2^d workers, one machine: median and range of the rounds")
    file.parent.mkdir(exist_ok=True)
    figure.tight_layout(rect=(0, 0.07, 1, 1))
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
