"""The scene and the report of two campaigns: a held module before a bay that is not where it is believed to be.

The right arm of the simulated cell holds a module by friction alone. The bay is displaced by up to 2 mm along each axis
and turned by up to 1 degree about each. The arm does not know it. A run succeeds if the module then rests in the seat.
It must be within 4 mm and 0.05 rad of its seated place, where the catch holds it.
"""

from __future__ import annotations

import argparse
import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, Protocol

import numpy as np

from benchmarks.report import percentile, question
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from sim_mcm.arms.detents import CATCHES_M, CATCHES_RAD
from tests.campaigns import advice, numbered_runs
from tests.campaigns.held_module import HeldModule
from tests.workers.conftest import CELL

SEED = 7
ARM, MODULE, BAY = "RIGHT-ARM", "MACS-NEW", "BAY-2"
ERROR_M, ERROR_RAD = 0.002, np.radians(1.0)
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
    tries: int
    failed: str = ""
    true: bool = True  # a reported success is one, and after a reported failure the arm holds still
    followed: advice.Followed | None = None  # the advice of a refusal or failure


class Inserter(Protocol):
    def run(self, offset: Array) -> Run:
        """One insertion with the bay displaced by `offset` (x y z roll pitch yaw; m, rad)."""
        ...


class BeforeBay(HeldModule):
    """The arm with the module in its hand before the bay, and this state to return to."""

    def __init__(self) -> None:
        super().__init__(ARM, MODULE, BEFORE)

    def displace(self, offset: Array) -> None:
        """Back to the state before the first run, with the bay displaced."""
        self.restore()
        seat = self.sim.world.seats[BAY]
        seat.home = geometry.compose(CELL.seat(BAY).frame.pose, geometry.from_rpy(offset[:3], offset[3:]))
        self.sim.world.place(seat, seat.home)

    def judge(self, in_hand: bool, peak_n: float, tries: int, failed: str = "") -> Run:
        """What has become of the module. `in_hand`: whether the hand should hold it now."""
        place = geometry.compose(self.sim.world.seats[BAY].home, CELL.seat(BAY).module_frame.pose)
        pose = self.sim.world.pose(MODULE)
        off_m, off_rad = geometry.distance(pose, place), geometry.angle(pose, place)
        caught = off_m < CATCHES_M and off_rad < CATCHES_RAD
        held = self.sim.held()[ARM] == ([MODULE] if in_hand else [])
        return Run(caught and held and not failed, off_m, off_rad, peak_n, tries, failed)


def offsets(seed: int) -> Iterator[Array]:
    """The errors of the bay, x y z roll pitch yaw (m, rad): the same ones each time."""
    random = np.random.default_rng(seed)
    while True:
        yield random.uniform(-1.0, 1.0, 6) * ([ERROR_M] * 3 + [ERROR_RAD] * 3)


def arguments(doc: str | None) -> argparse.ArgumentParser:
    words = numbered_runs.arguments(doc)
    words.add_argument("--rigid", action="store_true", help="position control instead, without results file")
    words.add_argument("--seed", type=int, default=SEED, help="of other errors, without results file")
    words.add_argument("--processes", type=int, default=1, help="share the runs; each has a scene of its own")
    return words


_mine: list[Inserter] = []  # of a process that shares the runs


def _prepare(make: Callable[[], Inserter]) -> None:
    _mine.append(make())


def _run(offset: Array) -> Run:
    return _mine[0].run(offset)


def _shared(make: Callable[[], Inserter], errors: Iterable[Array], processes: int) -> Iterator[Run]:
    """The runs in their order."""
    with multiprocessing.get_context("spawn").Pool(processes, _prepare, (make,)) as pool:
        yield from pool.imap(_run, errors)


def campaign(name: str, text: str, make: Callable[[], Inserter], given: argparse.Namespace) -> None:
    """Make the runs, and report them. `make` is called once in each process."""
    question(name, text, seed=given.seed)
    wanted = list(numbered_runs.chosen(given, offsets(given.seed)))
    found: list[Run] = []
    for (n, offset), run in zip(wanted, _shared(make, [offset for _, offset in wanted], given.processes), strict=True):
        found.append(run)
        if not run.seated or not run.true or run.tries > 1 or n % 20 == 19 or given.only:
            figures = ", ".join(f"{1e3 * x:.1f}" for x in offset)
            why = run.failed if run.true else f"{run.failed} WRONG REPORT"
            why += f" {run.followed.end}: {' | '.join(run.followed.history)}" if run.followed else ""
            end = "seated" if run.seated else f"NOT seated, off {1e3 * run.off_m:.1f} mm, {run.off_rad:.3f} rad"
            print(f"  run {n}: {end}, {run.tries} tries, {run.peak_n:.0f} N; error {figures} {why}", flush=True)
    seated = [run for run in found if run.seated]
    peaks = [run.peak_n for run in found]
    worst_mm = 1e3 * max((run.off_m for run in seated), default=0.0)
    ends, followed = advice.summary(run.followed.end for run in found if run.followed)
    rows = [
        ("seated", f"{len(seated)} of {len(found)}, {sum(run.tries == 1 for run in seated)} at the first attempt"),
        ("peak of the wrist force", f"p50 {percentile(peaks, 50):.0f} N, worst {max(peaks):.0f} N"),
        ("distance from the seated place, of those seated", f"worst {worst_mm:.1f} mm"),
        ("true reports", f"{sum(run.true for run in found)} of {len(found)}"),
        followed,
    ]
    metrics: dict[str, float | None] = {
        "runs": float(len(found)),
        "seated": float(len(seated)),
        "peak_n": max(peaks),
        **ends,
    }
    numbered_runs.report(name, metrics, rows, kept=not (given.rigid or given.only or given.seed != SEED))
