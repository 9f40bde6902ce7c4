"""How many commands go through all four phases per second, beside other people's machinery with the same chain?

    python -m benchmarks.throughput [--rounds 3] [--seconds 3] [--dims 2 3 4 5] [--no-peers] [--profile FILE]

Ours is the whole way of a command: accepted, journalled, parsed, elaborated, its performer reserved, bound, executed,
reported, analysed, its end told; by the real broker and the real shells with functions that do next to nothing
(`benchmarks.load`). The peers only pass bytes of the same sizes along a chain of four jobs (`benchmarks.peers`). Every
round measures everybody once, one after the other, so that a busy neighbour is everybody's; a ratio is the median of
the rounds' ratios. Nothing is trimmed.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from benchmarks.load.client import LoadClient
from benchmarks.load.cluster import cluster
from benchmarks.load.trivial import sentence
from benchmarks.peers import chain
from benchmarks.report import RESULTS, finish, question
from rtc.outcomes import OutcomeKind

WARM_UP_S = 1.5
#: metric -> module and name of the peer
PEERS = {
    "vs_raw_pyzmq": ("raw_pyzmq", "raw pyzmq, ROUTER and DEALER echo"),
    "vs_process_pool": ("process_pool", "ProcessPoolExecutor"),
    "vs_ray": ("ray_actors", "Ray actors"),
    "vs_celery": ("celery_redis", "Celery + Redis"),
    "vs_dask": ("dask_distributed", "Dask distributed"),
}


@dataclass(frozen=True)
class Run:
    """One measurement of ours."""

    commands_per_s: float
    decision_p99_ms: float
    latency_p50_ms: float
    cpu_us: dict[str, float]  # processor time per command, by process


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=3.0, help="of each measurement")
    parser.add_argument("--dims", type=int, nargs="+", default=[2, 3, 4, 5], help="of the cube: 2^dim workers")
    parser.add_argument("--window", type=int, default=1000, help="commands under way at a time")
    parser.add_argument("--no-peers", action="store_true")
    parser.add_argument("--profile", type=Path, help="keep the broker's cProfile here, and measure nothing else")
    given = parser.parse_args()
    text = f"how many trivial commands per second, {given.window} under way, journal on; and on other machinery?"
    question("throughput", text)
    if given.profile:
        print(
            f"with the profiler on: {ours(2, given.seconds, given.window, given.profile).commands_per_s:.0f} commands/s"
        )
        return
    runs: dict[int, list[Run]] = {dim: [] for dim in given.dims}
    rates: dict[str, list[float]] = {}
    missing: dict[str, str] = {}
    for number in range(1, given.rounds + 1):
        for dim in given.dims:
            run = ours(dim, given.seconds, given.window)
            runs[dim].append(run)
            say(
                number, f"{1 << dim} workers", f"{run.commands_per_s:.0f}/s, decisions p99 {run.decision_p99_ms:.2f} ms"
            )
        for metric, (module, name) in PEERS.items():
            if given.no_peers or metric in missing:
                continue
            answer = chain.ask(module, chain.SIZES, WARM_UP_S, given.seconds)
            if isinstance(answer, str):
                missing[metric] = answer
                say(number, name, answer)
            else:
                rates.setdefault(metric, []).append(answer)
                say(number, name, f"{answer:.0f}/s")
    report(given.dims, runs, rates, missing)


def ours(dim: int, for_s: float, window: int, profile: Path | None = None) -> Run:
    """One cluster, warmed up, measured, ended. SystemExit when a command did not succeed."""
    with cluster(dim, profile) as running, LoadClient(running.settings, sentence, window) as client:
        client.run(WARM_UP_S)
        client.latencies_s.clear()
        before = running.cpu_s()
        rate = client.run(for_s)
        after = running.cpu_s()
        latencies = sorted(client.latencies_s)
        client.drain()
        status = client.status()
        if set(client.outcomes) != {OutcomeKind.SUCCEEDED}:
            raise SystemExit(f"not every command succeeded: {dict(client.outcomes)}")
        return Run(
            commands_per_s=rate,
            decision_p99_ms=status["decision_ms"]["p99"],
            latency_p50_ms=1e3 * median(latencies),
            cpu_us={name: 1e6 * (after[name] - before[name]) / len(latencies) for name in after},
        )


def say(number: int, who: str, what: str) -> None:
    print(f"  round {number}: {who}: {what}", flush=True)


def report(
    dims: Sequence[int], runs: dict[int, list[Run]], rates: dict[str, list[float]], missing: dict[str, str]
) -> None:
    first = runs[dims[0]]
    metrics: dict[str, float | None] = {
        "commands_per_s": median(run.commands_per_s for run in first),
        "decision_p99_ms": median(run.decision_p99_ms for run in first),
    }
    rows = [
        (f"ours, {1 << dim} workers", f"{_spread([run.commands_per_s for run in runs[dim]])} commands/s")
        for dim in dims
    ]
    for metric, (_, name) in PEERS.items():
        theirs = rates.get(metric, [])
        ratios = [run.commands_per_s / rate for run, rate in zip(first, theirs, strict=False)]
        metrics[metric] = median(ratios) if ratios else None
        told = f"{_spread(theirs)} commands/s; ours is {_spread(ratios, 2)} times that" if ratios else ""
        rows.append((name, told or missing.get(metric, "not asked")))
    rows.append(("decision, p99 of the last 4096 turns", f"{_spread([r.decision_p99_ms for r in first], 2)} ms"))
    rows.append(("command, from sentence to end, p50", f"{_spread([r.latency_p50_ms for r in first])} ms"))
    for name in first[0].cpu_us:
        rows.append((f"processor time of {name}", f"{_spread([r.cpu_us[name] for r in first])} us per command"))
    draw({dim: [run.commands_per_s for run in runs[dim]] for dim in dims}, rates)
    finish("throughput", metrics, rows)


def _spread(values: Sequence[float], digits: int = 0) -> str:
    """Median and range."""
    return f"{median(values):.{digits}f} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def draw(rates: dict[int, list[float]], peers: dict[str, list[float]]) -> None:
    """results/throughput.png; nothing when matplotlib is not installed."""
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
    except ImportError:
        return
    figure, axes = pyplot.subplots(figsize=(7, 4.5))
    workers = [1 << dim for dim in rates]
    middle = [median(values) for values in rates.values()]
    below = [m - min(values) for m, values in zip(middle, rates.values(), strict=True)]
    above = [max(values) - m for m, values in zip(middle, rates.values(), strict=True)]
    axes.errorbar(
        workers, middle, yerr=[below, above], marker="o", capsize=4, label="ours, all four phases, journal on"
    )
    for (metric, values), style in zip(peers.items(), ("--", "-.", ":", (0, (5, 5)), (0, (1, 4))), strict=False):
        axes.axhline(median(values), linestyle=style, color="0.4", linewidth=1)
        axes.text(workers[-1], median(values), f" {PEERS[metric][1]}", fontsize=8, va="bottom", ha="right")
    axes.set_xscale("log", base=2)
    axes.set_xticks(workers, [str(n) for n in workers])
    axes.set_yscale("log")
    axes.set_xlabel("workers (peers: four)")
    axes.set_ylabel("commands per second (median and range)")
    axes.set_title("Trivial commands through all four phases, two cores")
    axes.legend(loc="lower right")
    RESULTS.mkdir(exist_ok=True)
    figure.tight_layout()
    figure.savefig(RESULTS / "throughput.png", dpi=120)


if __name__ == "__main__":
    main()
