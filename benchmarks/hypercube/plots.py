"""The plots of the simulated cluster. Without matplotlib nothing is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

Row = dict[str, Any]


def _pyplot() -> Any:
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
    except ImportError:
        return None
    return pyplot


def check(data: Sequence[Row], file: Path) -> None:
    """Simulated beside real throughput."""
    pyplot = _pyplot()
    if pyplot is None:
        return
    figure, axes = pyplot.subplots(figsize=(8, 6))
    for n, workload in enumerate(dict.fromkeys(row["workload"] for row in data)):
        rows = [row for row in data if row["workload"] == workload]
        workers = [row["workers"] for row in rows]
        real = [row["real_per_s"] for row in rows]
        error = [
            [row["real_per_s"] - row["real_range"][0] for row in rows],
            [row["real_range"][1] - row["real_per_s"] for row in rows],
        ]
        axes.errorbar(
            workers, real, yerr=error, marker="o", linestyle="", color=f"C{n}", capsize=4, label=f"{workload}, real"
        )
        simulated = [row["simulated"]["commands_per_s"] for row in rows]
        axes.plot(workers, simulated, "--", marker="x", color=f"C{n}", label=f"{workload}, simulated")
    _workers_axis(axes, sorted({row["workers"] for row in data}))
    axes.set_yscale("log")
    axes.set_ylabel("commands per second (real: median and range)")
    axes.set_title("The model and the real cluster on one machine")
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=4)
    _save(figure, file)


def scaling(rows: Sequence[Row], file: Path) -> None:
    """Throughput over the number of workers: one broker, and several."""
    pyplot = _pyplot()
    if pyplot is None:
        return
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(14, 8), sharey=True)
    one = [row for row in rows if row["experiment"].startswith("one broker")]
    for experiment, workload in dict.fromkeys((row["experiment"], row["workload"]) for row in one):
        _line(
            left,
            [r for r in one if (r["experiment"], r["workload"]) == (experiment, workload)],
            f"{experiment}, {workload}",
        )
    left.set_title("One broker")
    several = [row for row in rows if row["brokers"] > 1]
    for n, brokers in enumerate(sorted({row["brokers"] for row in several})):
        for experiment, style in (
            ("shared pool, nearest first", "-"),
            ("shared pool, lowest first", ":"),
            ("shared pool, nearest first, dimension-order", "-."),
            ("own workers", "--"),
        ):
            some = [r for r in several if (r["brokers"], r["experiment"]) == (brokers, experiment)]
            _line(right, some, f"{brokers} brokers, {experiment}", style, f"C{n}")
    right.set_title("Several brokers, jobs of 4 ms")
    for axes in (left, right):
        _workers_axis(axes, sorted({row["workers"] for row in rows})[::2])
        axes.set_yscale("log")
        axes.legend(fontsize=8, handlelength=4, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2)
    left.set_ylabel("commands per second, simulated")
    figure.suptitle("Simulated cluster, a core per process, measured service and link times")
    _save(figure, file)


def halts(rows: Sequence[Row], file: Path) -> None:
    """Halts and waiting: over the number of workers, and over the load."""
    pyplot = _pyplot()
    if pyplot is None:
        return
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(13, 5))
    jobs = [row for row in rows if row["workload"] == "asleep-4ms" and row["experiment"] != "load"]
    for experiment, brokers in dict.fromkeys((row["experiment"], row["brokers"]) for row in jobs):
        if experiment in ("one broker", "own workers", "shared pool, nearest first"):
            some = [r for r in jobs if (r["experiment"], r["brokers"]) == (experiment, brokers)]
            style = "-" if experiment.startswith("shared") else "--"
            _line(left, some, f"{experiment}, {brokers} x broker", style, name="halt_p99_ms")
    _workers_axis(left, sorted({row["workers"] for row in rows})[::2])
    left.set_yscale("log")
    left.set_ylabel("halt to its receipt through the broker, p99 (ms)")
    left.set_title("Halts, window of commands full")
    left.legend(fontsize=8)
    load = [row for row in rows if row["experiment"] == "load"]
    for name, label in (
        ("waiting_p50_ms", "waiting of a command, p50"),
        ("halt_p50_ms", "halt, p50"),
        ("halt_p99_ms", "halt, p99"),
    ):
        right.plot([row["rate"] for row in load], [row[name] for row in load], marker="o", label=label)
    right.set_yscale("log")
    right.set_xlabel("commands per second offered to one broker, at random times")
    right.set_ylabel("ms")
    right.set_title(f"One broker, {load[0]['workers']} workers, jobs of 4 ms" if load else "")
    right.legend(fontsize=8)
    _save(figure, file)


def _line(
    axes: Any,
    rows: Sequence[Row],
    label: str,
    style: str = "-",
    colour: str | None = None,
    name: str = "commands_per_s",
) -> None:
    if rows:
        x, y = [row["workers"] for row in rows], [row[name] for row in rows]
        axes.plot(x, y, style, marker="o", markersize=3, label=label, color=colour)


def _workers_axis(axes: Any, workers: Sequence[int]) -> None:
    axes.set_xscale("log", base=2)
    axes.set_xticks(workers, [f"{n:,}" for n in workers], fontsize=8)
    axes.set_xlabel("workers")
    axes.grid(alpha=0.3)


def _save(figure: Any, file: Path) -> None:
    file.parent.mkdir(exist_ok=True)
    figure.tight_layout()
    figure.savefig(file, dpi=120)
