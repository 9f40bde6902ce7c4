"""How many commands per second pass all four phases, compared with other frameworks with the same chain?

    python -m benchmarks.throughput [--rounds 3] [--seconds 3] [--dims 2 3 4 5] [--no-peers] [--profile FILE]

A command of ours passes the whole journey: accepted, journalled, parsed, elaborated, its performer reserved, bound,
executed, reported, analysed, its end reported. Broker and worker loop are real, the worker functions trivial
(`benchmarks.load`). The peers only pass bytes of the same sizes along a chain of four jobs (`benchmarks.peers`). Each
round measures all of them once, one after the other, so that a busy machine affects all. A ratio is the median of the
rounds' ratios. Nothing is trimmed.

Two more figures of the same cluster are measured. One is the time from a message to its effects in the broker while all
workers are saturated (jobs of BUSY_S each). The other is the rate of real sentences as far as a bound motion. The
latter has the real parser, elaborator and binder on the real cell with two arms. Its subsystem ends each primitive
without motion.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from benchmarks.load.client import LoadClient
from benchmarks.load.cluster import cluster
from benchmarks.load.trivial import sentence
from benchmarks.peers import chain
from benchmarks.report import RESULTS, finish, question
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import OutcomeKind

WARM_UP_S = 1.5
BUSY_S = 0.002  # duration of each job, to saturate the workers
SATURATING = 100  # commands in progress; enough to saturate them
PLANNERS = (WorkerKind.PARSER, WorkerKind.ELABORATOR, WorkerKind.BINDER)
MOTIONS = ("MOVE RIGHT-ARM TO BAY-2-FRONT", "MOVE LEFT-ARM TO CLEAR-POINT-1")
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
    """One measurement of our cluster."""

    commands_per_s: float
    turn_p50_ms: float  # broker's loop, from messages to their effects, the last 4096 iterations
    turn_p99_ms: float
    latency_p50_ms: float
    cpu_us: dict[str, float]  # processor time per command, by process


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=3.0, help="of each measurement")
    parser.add_argument("--dims", type=int, nargs="+", default=[2, 3, 4, 5], help="of the cube: 2^dim workers")
    parser.add_argument("--window", type=int, default=1000, help="commands under way at a time")
    parser.add_argument("--no-peers", action="store_true")
    parser.add_argument(
        "--profile", type=Path, help="write the broker's cProfile to this file, and measure nothing else"
    )
    given = parser.parse_args()
    text = f"how many trivial commands per second, {given.window} in progress, journal on; and on other frameworks?"
    question("throughput", text)
    if given.profile:
        rate = flood(2, given.seconds, given.window, profile=given.profile).commands_per_s
        print(f"with the profiler on: {rate:.0f} commands/s; see python -m pstats {given.profile}")
        return
    found = Figures()
    for number in range(1, given.rounds + 1):
        for who, what in measure(found, given):
            print(f"  round {number}: {who}: {what}", flush=True)
    draw(found)
    finish("throughput", found.metrics(), found.rows())


def measure(found: Figures, given: argparse.Namespace) -> Iterator[tuple[str, str]]:
    """One round; prints its figures."""
    for dim in given.dims:
        run = flood(dim, given.seconds, given.window)
        found.floods.setdefault(dim, []).append(run)
        yield f"{1 << dim} workers", f"{run.commands_per_s:.0f}/s, a turn takes {run.turn_p50_ms:.2f} ms"
    run = flood(2, given.seconds, SATURATING, busy_s=BUSY_S)
    found.saturated.append(run.turn_p99_ms)
    yield "workers saturated", f"message to effects p99 {run.turn_p99_ms:.2f} ms"
    run = flood(3, given.seconds, SATURATING, real=PLANNERS, text=motion)
    found.sentences.append(run.commands_per_s)
    yield "real sentences as far as bound, 8 workers", f"{run.commands_per_s:.0f}/s"
    for metric, (module, name) in PEERS.items():
        if given.no_peers or metric in found.missing:
            continue
        answer = chain.ask(module, chain.SIZES, WARM_UP_S, given.seconds)
        if isinstance(answer, str):
            found.missing[metric] = answer
            yield name, answer
        else:
            found.peers.setdefault(metric, []).append(answer)
            yield name, f"{answer:.0f}/s"


def motion(n: int) -> str:
    return MOTIONS[n % len(MOTIONS)]


def flood(
    dim: int,
    for_s: float,
    window: int,
    *,
    profile: Path | None = None,
    busy_s: float = 0.0,
    real: Sequence[WorkerKind] = (),
    text: Callable[[int], str] = sentence,
) -> Run:
    """Start, warm up, measure and end one cluster. Raises SystemExit if a command did not succeed."""
    with (
        cluster(dim, profile=profile, busy_s=busy_s, real=real) as running,
        LoadClient(running.settings, text, window) as client,
    ):
        client.run(2 * WARM_UP_S if real else WARM_UP_S)
        client.latencies_s.clear()
        before = running.cpu_s()
        rate = client.run(for_s)
        after = running.cpu_s()
        latencies = client.latencies_s.copy()
        client.drain()
        turn_ms = client.status().decision_ms
        if set(client.outcomes) != {OutcomeKind.SUCCEEDED}:
            raise SystemExit(f"not every command succeeded: {dict(client.outcomes)}")
        return Run(
            commands_per_s=rate,
            turn_p50_ms=turn_ms["p50"],
            turn_p99_ms=turn_ms["p99"],
            latency_p50_ms=1e3 * median(latencies),
            cpu_us={name: 1e6 * (after[name] - before[name]) / len(latencies) for name in after},
        )


@dataclass
class Figures:
    """All measurements, round by round."""

    floods: dict[int, list[Run]] = field(default_factory=dict)  # by dimension of the cube
    saturated: list[float] = field(default_factory=list)  # p99 of message to effects, ms
    sentences: list[float] = field(default_factory=list)  # per second
    peers: dict[str, list[float]] = field(default_factory=dict)  # metric -> commands per second
    missing: dict[str, str] = field(default_factory=dict)  # metric -> reason for its absence

    @property
    def first(self) -> list[Run]:
        """The measurements of the smallest cube, which are compared with the peers."""
        return next(iter(self.floods.values()))

    def ratios(self, metric: str) -> list[float]:
        return [run.commands_per_s / rate for run, rate in zip(self.first, self.peers.get(metric, ()), strict=False)]

    def metrics(self) -> dict[str, float | None]:
        return {
            "commands_per_s": median(run.commands_per_s for run in self.first),
            **{metric: median(ratios) if (ratios := self.ratios(metric)) else None for metric in PEERS},
            "decision_p99_ms": median(self.saturated),
            "sentences_per_s": median(self.sentences),
        }

    def rows(self) -> Iterator[tuple[str, str]]:
        for dim, runs in self.floods.items():
            yield f"ours, {1 << dim} workers", f"{spread([run.commands_per_s for run in runs])} commands/s"
        for metric, (_, name) in PEERS.items():
            if ratios := self.ratios(metric):
                yield name, f"{spread(self.peers[metric])} commands/s; ours is {spread(ratios, 2)} times that"
            else:
                yield name, self.missing.get(metric, "not asked")
        yield "message to effects, workers saturated, p99", f"{spread(self.saturated, 2)} ms"
        yield "a turn of the broker under the flood, p50", f"{spread([run.turn_p50_ms for run in self.first], 2)} ms"
        yield "the same, p99", f"{spread([run.turn_p99_ms for run in self.first], 2)} ms"
        yield "a command under the flood, p50", f"{spread([run.latency_p50_ms for run in self.first])} ms"
        for name in self.first[0].cpu_us:
            yield f"processor time of {name}", f"{spread([run.cpu_us[name] for run in self.first])} us per command"
        yield "real sentences as far as bound", f"{spread(self.sentences)} commands/s"


def spread(values: Sequence[float], digits: int = 0) -> str:
    """Median and range."""
    return f"{median(values):.{digits}f} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def draw(found: Figures) -> None:
    """results/throughput.png; skipped without matplotlib."""
    rates = {1 << dim: [run.commands_per_s for run in runs] for dim, runs in found.floods.items()}
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
    except ImportError:
        return
    figure, axes = pyplot.subplots(figsize=(7, 4.5))
    workers = list(rates)
    middle = [median(values) for values in rates.values()]
    below = [m - min(values) for m, values in zip(middle, rates.values(), strict=True)]
    above = [max(values) - m for m, values in zip(middle, rates.values(), strict=True)]
    axes.errorbar(
        workers, middle, yerr=[below, above], marker="o", capsize=4, label="ours, all four phases, journal on"
    )
    for n, (metric, values) in enumerate(found.peers.items()):
        axes.axhline(median(values), linestyle=("--", "-.", ":")[n % 3], color="0.4", linewidth=1)
        left = n % 2  # alternately left and right
        at, side = (workers[0], "left") if left else (workers[-1], "right")
        axes.text(at, median(values), PEERS[metric][1], fontsize=8, va="bottom", ha=side)
    axes.set_xscale("log", base=2)
    axes.set_xticks(workers, [str(n) for n in workers])
    axes.set_yscale("log")
    axes.set_xlabel("workers (peers: four)")
    axes.set_ylabel("commands per second (median and range)")
    axes.set_title("Trivial commands through all four phases, two cores")
    axes.legend(loc="center left")
    RESULTS.mkdir(exist_ok=True)
    figure.tight_layout()
    figure.savefig(RESULTS / "throughput.png", dpi=120)


if __name__ == "__main__":
    main()
