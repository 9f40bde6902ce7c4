"""The tables of `docs/scaling.md`, made from the results files, so that its figures are those of the results. Pure,
but for `update`."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.hypercube.check import LIMIT
from benchmarks.report import RESULTS

PAGE = Path(__file__).parents[2] / "docs" / "scaling.md"
DIMS_SHOWN = (2, 4, 6, 8, 10, 12, 14, 16)
Row = dict[str, Any]
ENGINES = {"process": "processes", "ray": "Ray actors"}


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def real(data: Sequence[Row]) -> str:
    """Measured clusters: medians and ranges of the rounds."""
    head = ("load", "workers", "commands/s", "p50, p99, ms", "waiting, ms", "halt p50, p99, ms", "broker, us")
    rows = []
    for row in data:
        halts = f"{row['halt_p50_ms'][0]:.1f}, {row['halt_p99_ms'][0]:.1f}" if "halt_p50_ms" in row else ""
        rows.append(
            (
                row["workload"],
                f"{row['workers']} {ENGINES[row['engine']]}",
                _spread(row["commands_per_s"]),
                f"{row['latency_p50_ms'][0]:.1f}, {row['latency_p99_ms'][0]:.1f}",
                f"{row['waiting_p50_ms'][0]:.1f}",
                halts,
                f"{row['broker_us'][0]:.0f}",
            )
        )
    return table(head, rows)


def check(data: Sequence[Row]) -> str:
    """Real beside simulated."""
    head = ("load", "workers", "real, commands/s", "simulated", "error", "waiting p50, ms: both", "broker, us: both")
    rows = [
        (
            row["workload"],
            str(row["workers"]),
            _spread([row["real_per_s"], *row["real_range"]]),
            f"{row['simulated']['commands_per_s']:.0f}",
            f"{100 * row['error']:+.0f} %",
            f"{row['real_waiting_ms']:.1f}, {row['simulated']['waiting_p50_ms']:.1f}",
            f"{row['real_broker_us']:.0f}, {row['broker_us']:.0f}",
        )
        for row in data
    ]
    return table(head, rows)


def one_broker(data: Sequence[Row]) -> str:
    """Throughput of one broker by the number of its workers."""
    columns = (
        ("one broker", "trivial", "trivial jobs"),
        ("one broker", "real", "real planners"),
        ("one broker", "asleep-4ms", "jobs of 4 ms"),
        ("one broker, dimension-order", "asleep-4ms", "the same, dimension-order"),
    )
    rows = []
    for workers in _shown(data):
        cells = [_cell(data, workers, experiment, workload, 1) for experiment, workload, _ in columns]
        slow = _find(data, workers, "one broker", "asleep-4ms", 1)
        rows.append(
            (f"{workers:,}", *cells, f"{100 * slow['background']:.1f} %" if slow else "", slow["limit"] if slow else "")
        )
    head = ("workers", *(title for *_, title in columns), "checks and heartbeats", "what limits the jobs of 4 ms")
    return table(head, rows)


def several_brokers(data: Sequence[Row]) -> str:
    """Throughput of several brokers, jobs of 4 ms."""
    names = ("own workers", "shared pool, lowest first", "shared pool, nearest first")
    cubic = f"{names[2]}, dimension-order"
    rows = []
    for brokers in sorted({row["brokers"] for row in data if row["brokers"] > 1}):
        for workers in _shown(data):
            if any(row["brokers"] == brokers and row["workers"] == workers for row in data):
                cells = [_cell(data, workers, name, "asleep-4ms", brokers) for name in (*names, cubic)]
                near = _find(data, workers, names[2], "asleep-4ms", brokers)
                routed = _find(data, workers, cubic, "asleep-4ms", brokers)
                halt = f"{near['halt_p99_ms']:.1f}" if near else ""
                relay = f"{100 * routed['relay_busy']:.0f} %" if routed else ""
                rows.append((str(brokers), f"{workers:,}", *cells, relay, halt))
    return table(("brokers", "workers", *names, "the same, dimension-order", "busiest relay", "halt p99, ms"), rows)


def load(data: Sequence[Row]) -> str:
    """One broker at parts of its throughput."""
    rows = [
        (
            f"{row['rate']:.0f}",
            f"{row['latency_p50_ms']:.1f}, {row['latency_p99_ms']:.1f}",
            f"{row['waiting_p50_ms']:.2f}",
            f"{row['halt_p50_ms']:.2f}, {row['halt_p99_ms']:.2f}",
            f"{100 * row['broker_busy']:.0f} %",
        )
        for row in data
        if row["experiment"] == "load"
    ]
    return table(
        ("commands/s offered", "command p50, p99, ms", "waiting p50, ms", "halt p50, p99, ms", "broker busy"), rows
    )


def origin(document: Row) -> str:
    """When the results were measured, and how busy the machine was before."""
    about = document["machine"]
    load = about["load_before"][0] if about["load_before"] else 0.0
    return f"\nMeasured {about['at']}, load of the machine before: {load:.1f} on {about['cores']} cores.\n"


def verdict(data: Sequence[Row]) -> str:
    """How many cases of the check are within its limit."""
    within = sum(abs(row["error"]) <= LIMIT for row in data)
    worst = max(data, key=lambda row: abs(row["error"]))
    where = f"{100 * worst['error']:+.0f} % ({worst['label']})"
    return f"\nWithin {100 * LIMIT:.0f} %: {within} of {len(data)} cases; worst {where}.\n"


#: table of the page -> (results file, function)
TABLES: dict[str, tuple[str, Callable[[Sequence[Row]], str]]] = {
    "real": ("scaling", real),
    "check": ("hypercube_check", check),
    "one broker": ("hypercube", one_broker),
    "several brokers": ("hypercube", several_brokers),
    "load": ("hypercube", load),
}


def filled(page: str, results: Path = RESULTS) -> str:
    """The page with its tables made anew. Raises FileNotFoundError without a results file."""
    for name, (file, make) in TABLES.items():
        document = json.loads((results / f"{file}.json").read_text())
        made = make(document["data"])
        made += origin(document) if name == "real" else verdict(document["data"]) if name == "check" else ""
        begin, end = f"<!-- table: {name} -->\n", "<!-- end of table -->"
        page = re.sub(f"{begin}.*?{end}", lambda _, text=f"{begin}{made}{end}": text, page, flags=re.DOTALL)  # type: ignore[misc]
    return page


def update() -> None:
    PAGE.write_text(filled(PAGE.read_text()))


def _spread(values: Sequence[float]) -> str:
    middle, low, high = values
    return f"{middle:.0f} ({low:.0f} to {high:.0f})"


def _shown(data: Sequence[Row]) -> list[int]:
    return sorted({row["workers"] for row in data if row["dim"] in DIMS_SHOWN})


def _find(data: Sequence[Row], workers: int, experiment: str, workload: str, brokers: int) -> Row | None:
    wanted = (workers, experiment, workload, brokers)
    return next((r for r in data if (r["workers"], r["experiment"], r["workload"], r["brokers"]) == wanted), None)


def _cell(data: Sequence[Row], workers: int, experiment: str, workload: str, brokers: int) -> str:
    row = _find(data, workers, experiment, workload, brokers)
    return "" if row is None else f"{row['commands_per_s']:,.0f}"
