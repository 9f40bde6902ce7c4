"""Are the halts of a page answered while another page floods the gateway of the console?

Eight kinds of frames, from four sockets each, without end. The page that halts is judged alone: its thread has
real-time priority if that is permitted.

    python -m tests.campaigns.page_floods [--halts 1000]
"""

from __future__ import annotations

import argparse
import os
from contextlib import nullcontext
from typing import Any

from benchmarks.report import percentile, question
from rtc.apps.demos.own_cluster import own_cluster
from tests.apps.console.flood import KINDS, HaltingPage, Pages, flood, undelayed
from tests.apps.console.test_in_browser import Gateway
from tests.campaigns import numbered_runs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--halts", type=int, default=1000, help="of each kind of flood")
    given = parser.parse_args()
    question("page_floods", "Are halts of a page answered while another page floods?")
    rows, metrics = [], {}
    with own_cluster(mcm="kinematic") as run_dir:
        gateway = Gateway(run_dir)
        pages = Pages.admitted(gateway.link)
        for kind in ("none", *KINDS):
            answers = answers_in(pages, kind, given.halts)
            times_ms = [1e3 * took_s for took_s, _ in answers]
            unconfirmed = sum(not result.get("confirmed") for _, result in answers)
            p50_ms, p99_ms = percentile(times_ms, 50), percentile(times_ms, 99)
            name = kind.replace(" ", "_")
            metrics |= {f"{name}_p99_ms": p99_ms, f"{name}_unconfirmed": unconfirmed}
            words = f"p50 {p50_ms:.1f}, p99 {p99_ms:.1f}, worst {max(times_ms):.1f} ms; {unconfirmed} not confirmed"
            rows.append((kind, f"{words}; n {len(answers)}, load {os.getloadavg()[0]:.0f}"))
            print(*rows[-1], flush=True)
        gateway.end()
    numbered_runs.report("page_floods", metrics, rows, kept=given.halts >= 1000)


def answers_in(pages: Pages, kind: str, halts: int) -> list[tuple[float, Any]]:
    page = HaltingPage(pages)
    with flood(pages, kind) if kind in KINDS else nullcontext(), undelayed():
        answers = [page.halt() for _ in range(halts)]
    page.close()
    return answers


if __name__ == "__main__":
    main()
