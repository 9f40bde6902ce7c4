"""What the campaigns of insertion share: a seat displaced at random, one run for each, and the report."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmarks.report import finish, percentile
from rtc.robot.geometry import Array
from tests.campaigns import RESULTS

SEED = 7
ARM, MODULE, BAY = "RIGHT-ARM", "MACS-NEW", "BAY-2"
ERROR_M, ERROR_RAD = 0.002, np.radians(1.0)
#: sentences after which the arm has the module in its hand before the bay
BEFORE = (
    f"GRASP RIGHT-END-EFF {MODULE} HANDLE-A",
    f"LIFT {MODULE} BY 25 CM WITH {ARM}",
    f"MOVE {ARM} TO BAY-2-FRONT",
)


class Run(NamedTuple):
    seated: bool
    off_m: float  # from the seated place
    off_rad: float
    peak_n: float
    again: int  # attempts after the first
    failed: str = ""  # why


def options(doc: str | None) -> argparse.Namespace:
    """`runs` and `rigid`, from the command line."""
    words = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--runs", type=int, default=100)
    words.add_argument("--rigid", action="store_true", help="position control instead, without results file")
    return words.parse_args()


def run_all(run: Callable[[Array], Run], runs: int) -> list[Run]:
    """One run for each offset of the seat (x y z roll pitch yaw; m, rad). Prints the remarkable ones."""
    random = np.random.default_rng(SEED)
    found: list[Run] = []
    for n in range(runs):
        offset = random.uniform(-1.0, 1.0, 6) * ([ERROR_M] * 3 + [ERROR_RAD] * 3)
        one = run(offset)
        found.append(one)
        if not one.seated or one.again or n % 20 == 19:
            figures = ", ".join(f"{1e3 * x:.1f}" for x in offset)
            end = "seated" if one.seated else f"NOT seated, off {1e3 * one.off_m:.1f} mm, {one.off_rad:.3f} rad"
            print(
                f"  run {n}: {end}, {one.again} more attempts, {one.peak_n:.0f} N; error {figures} {one.failed}",
                flush=True,
            )
    return found


def write_report(name: str, found: list[Run], write: bool) -> None:
    """Print the figures, and with `write` put them into the results file of the campaign."""
    seated = [run for run in found if run.seated]
    peaks = [run.peak_n for run in found]
    worst_mm = 1e3 * max((run.off_m for run in seated), default=0.0)
    rows = [
        ("seated", f"{len(seated)} of {len(found)}, {sum(not run.again for run in seated)} at the first attempt"),
        ("peak of the wrist force", f"p50 {percentile(peaks, 50):.0f} N, worst {max(peaks):.0f} N"),
        ("distance from the seated place, of those seated", f"worst {worst_mm:.1f} mm"),
    ]
    if not write:
        print(rows)
        return
    metrics = {"runs": float(len(found)), "seated": float(len(seated)), "peak_n": max(peaks)}
    finish(name, metrics, rows, RESULTS)
