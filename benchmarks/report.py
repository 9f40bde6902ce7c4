"""Output of every benchmark: a table for people, a file in results/, and one line of JSON at the end.

    question("world", "How long does a grouped read of 50 facts take?")
    ...
    finish("world", {"read50_p50_us": 123.4, "vs_redis": None}, rows=[("read of 50", "123 us")])

Latencies are percentiles of all samples, including the worst; nothing is trimmed.
"""

from __future__ import annotations

import json
import math
import os
import platform
import subprocess
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"
_before: dict[str, Any] = {}  # state of the machine at the start


def question(name: str, text: str, *, seed: int | None = None) -> None:
    """Print the question, the machine and the seed."""
    _before.update(load=list(os.getloadavg()), processor_s=_processor_s())
    print(f"{name}: {text}")
    print(f"machine: {machine()['cpu']}, {machine()['cores']} cores, Python {platform.python_version()}", end="")
    print(f"; seed {seed}" if seed is not None else "", flush=True)


def percentile(samples: Sequence[float], percent: float) -> float:
    """The sample that `percent` % of all do not exceed (nearest rank). Raises ValueError without samples."""
    if not samples:
        raise ValueError("a percentile of no samples")
    ranked = sorted(samples)
    return ranked[max(0, math.ceil(len(ranked) * percent / 100) - 1)]


def spread(samples: Sequence[float], scale: float = 1.0, unit: str = "s") -> str:
    """Median, p99 and worst as text."""
    p50, p99, worst = (scale * percentile(samples, p) for p in (50, 99, 100))
    return f"p50 {p50:.4g} {unit}, p99 {p99:.4g} {unit}, worst {worst:.4g} {unit} of {len(samples)}"


def machine() -> dict[str, Any]:
    """Properties of the machine and versions on which the figures depend."""
    cpu = platform.processor() or platform.machine()
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                cpu = line.partition(":")[2].strip()
                break
    return {
        "cpu": cpu,
        "cores": len(os.sched_getaffinity(0)),
        "system": platform.platform(),
        "python": platform.python_version(),
        "load_before": _before.get("load", []),
        "stolen_percent": _stolen_percent(),
        "commit": _commit(),
        "at": time.strftime("%Y-%m-%d %H:%M:%S"),
    }


def finish(
    name: str,
    metrics: dict[str, float | None],
    rows: Iterable[tuple[str, str]] | None = None,
    folder: Path = RESULTS,
    data: Any = None,
) -> None:
    """Print the table, write `folder`/NAME.json, and print one line of JSON for tools.

    `data`: further results for the file, that other programs read."""
    shown = list(rows) if rows is not None else [(key, _figure(value)) for key, value in metrics.items()]
    width = max((len(label) for label, _ in shown), default=0)
    print()
    for label, value in shown:
        print(f"  {label:<{width}}  {value}")
    print(f"  {'(stolen by the host)':<{width}}  {_stolen_percent():g} % of the processor time")
    print()
    folder.mkdir(exist_ok=True)
    document = {"benchmark": name, "metrics": metrics, "rows": dict(shown), "machine": machine()}
    text = json.dumps(document, indent=2)
    if data is not None:
        text = f'{text[:-2]},\n  "data": {_lines(data)}\n}}'
    (folder / f"{name}.json").write_text(text + "\n")
    print(json.dumps({"benchmark": name, "metrics": metrics}), flush=True)


def _lines(data: Any) -> str:
    """JSON with one line for each item of a list."""
    if not isinstance(data, list):
        return json.dumps(data, indent=2).replace("\n", "\n  ")
    rows = ",\n    ".join(json.dumps(row) for row in data)
    return f"[\n    {rows}\n  ]"


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _processor_s() -> tuple[float, float]:
    """(processor time stolen by the host of a virtual machine, all processor time) since boot."""
    times = [int(word) for word in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    return float(times[7]), float(sum(times))


def _stolen_percent() -> float:
    """Share of processor time stolen by the host since the question (%); it affects the worst figures."""
    if "processor_s" not in _before:
        return 0.0
    (stolen, total), (stolen_then, total_then) = _processor_s(), _before["processor_s"]
    return round(100.0 * (stolen - stolen_then) / max(1.0, total - total_then), 2)


def _commit() -> str:
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--dirty"], cwd=RESULTS.parent, capture_output=True, text=True, timeout=5
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return found.stdout.strip()
