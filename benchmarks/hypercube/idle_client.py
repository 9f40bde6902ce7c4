"""The load client in a process of its own: `python -m benchmarks.hypercube.idle_client --run-dir D --window 64`."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.load.client import LoadClient
from benchmarks.load.trivial import sentence
from rtc.runtime.settings import Settings


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run-dir", required=True, type=Path)
    parser.add_argument("--window", type=int, required=True)
    given = parser.parse_args()
    with LoadClient(Settings.load(given.run_dir), sentence, given.window) as client:
        client.run(float("inf"))  # until it is killed


if __name__ == "__main__":
    main()
