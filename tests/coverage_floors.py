"""Fails if a package is tested less than its floor: `python -m tests.coverage_floors out/coverage.json`.

The figures are lines and branches that the tests without processes reach; `make coverage` measures them. What only runs
in processes of its own (the command line, demos, main loops) is covered by slow tests, which this does not count.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from pathlib import Path

#: package -> percent of lines and branches; the longest prefix counts. A floor is only raised.
FLOORS = {
    "broker/": 40,
    "broker/decisions/": 93,
    "broker/dispatch/": 97,
    "broker/gateway/": 74,
    "broker/persistence/": 92,
    "broker/router/": 93,
    "deploy/": 44,
    "rtc/apps/": 53,
    "rtc/apps/authoring/": 88,
    "rtc/apps/demos/": 18,
    "rtc/apps/observers/": 84,
    "rtc/client/": 85,
    "rtc/drawing/": 90,
    "rtc/language/": 92,
    "rtc/model/": 94,
    "rtc/plugins/": 90,
    "rtc/programs/": 94,
    "rtc/protocol/": 94,
    "rtc/runtime/": 78,
    "rtc/sensing/": 92,
    "rtc/spatial/": 97,
    "rtc/subsystems/base/": 80,
    "rtc/subsystems/motion/": 85,
    "rtc/subsystems/perception/": 60,
    "rtc/world/": 92,
    "sim_mcm/": 41,
    "sim_mcm/arms/": 94,
    "sim_mcm/cameras/": 71,
    "workers/": 57,
    "workers/analyzer/": 77,
    "workers/binder/": 79,
    "workers/conditions/": 89,
    "workers/elaborator/": 86,
    "workers/parser/": 90,
    "workers/planning/": 95,
    "workers/runtime/": 84,
}


def shares(report: dict[str, dict[str, dict[str, dict[str, int]]]]) -> dict[str, float]:
    """Package -> percent, of a report of `coverage json`."""
    reached, all_of = defaultdict(int), defaultdict(int)
    for name, file in report["files"].items():
        package = max((prefix for prefix in FLOORS if name.startswith(prefix)), key=len, default="")
        reached[package] += file["summary"]["covered_lines"] + file["summary"]["covered_branches"]
        all_of[package] += file["summary"]["num_statements"] + file["summary"]["num_branches"]
    return {package: 100 * reached[package] / all_of[package] for package in all_of if package and all_of[package]}


def main(file: str) -> int:
    found = shares(json.loads(Path(file).read_text()))
    for package, percent in sorted(found.items()):
        low = percent < FLOORS[package]
        print(f"{package:28s} {percent:5.1f} %  floor {FLOORS[package]} %{'  TOO LOW' if low else ''}")
    missing = FLOORS.keys() - found.keys()
    print(*(f"{package} was not measured" for package in sorted(missing)), sep="\n")
    return 1 if missing or any(percent < FLOORS[package] for package, percent in found.items()) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
