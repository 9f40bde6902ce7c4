"""How long does `rtc up -d` take until the cluster is ready?

Each run starts a whole cluster in a new run directory and ends it. The figure is the median of the runs, from the start
of the command until it returns. The end is timed separately.

    python -m benchmarks.startup [--runs 5] [--mcm bullet|kinematic] [--dim 2]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time

from benchmarks.report import finish, percentile, question, spread

LIMIT_S = 60.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--mcm", default="bullet")
    parser.add_argument("--dim", default="2")
    given = parser.parse_args()
    question("startup", f"how long until `rtc up -d --mcm {given.mcm} --dim {given.dim}` is ready?")
    ready, ended = [], []
    slowest: dict[str, float] = {}
    for run in range(given.runs):
        with tempfile.TemporaryDirectory(prefix="rtc-bench-") as folder:
            lines, took_s = _timed("up", "--mcm", given.mcm, "--dim", given.dim, "--run-dir", folder, "-d")
            ready.append(took_s)
            ended.append(_timed("down", "--run-dir", folder)[1])
            for name, seconds in _ready_times(lines):
                slowest[name] = max(seconds, slowest.get(name, 0.0))
        print(f"  run {run + 1} of {given.runs}: ready in {ready[-1]:.2f} s, down in {ended[-1]:.2f} s", flush=True)
    finish(
        "startup",
        {"ready_s": percentile(ready, 50), "ready_worst_s": max(ready), "down_s": percentile(ended, 50)},
        [
            ("up -d until ready", spread(ready)),
            ("down until ended", spread(ended)),
            *((f"  {name}, at worst", f"{seconds:.2f} s") for name, seconds in slowest.items()),
        ],
    )


def _timed(*arguments: str) -> tuple[list[str], float]:
    """The command's output lines and its duration (s). Raises SystemExit if it fails."""
    began = time.perf_counter()
    command = [sys.executable, "-m", "rtc.apps.cli.main", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)
    took_s = time.perf_counter() - began
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)} failed:\n{done.stdout}{done.stderr}")
    return done.stdout.splitlines(), took_s


def _ready_times(lines: list[str]) -> list[tuple[str, float]]:
    """(process, seconds) of lines such as `binder@2  ready  1.20 s  pid 7`."""
    words = [line.split() for line in lines]
    return [(w[0], float(w[2])) for w in words if len(w) >= 4 and w[1] == "ready" and w[3] == "s"]


if __name__ == "__main__":
    main()
