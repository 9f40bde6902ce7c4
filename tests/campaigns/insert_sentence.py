"""Does a compliant arm bring a module into a seat that is not where it is believed to be?

The right arm of the simulated cell holds a module by friction alone, before the bay. The bay is displaced by up to
2 mm along each axis and turned by up to 1 degree about each, without the knowledge of the arm. Then one sentence,
INSERT, carries the module over the lips and into the slot (1.5 mm of clearance), tugs at it, lets go and backs off. A
run succeeds if the command does, and the module then rests in the seat: within 4 mm and 0.05 rad of its seated place,
where the catch holds it. For comparison, the same errors with PLACE, which is position-controlled (`--rigid`).

    python -m tests.campaigns.insert_sentence [--runs 100]
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np
import pybullet

from benchmarks.report import finish, percentile, question
from rtc.protocol import primitive as p
from rtc.robot import geometry
from rtc.robot.geometry import Array
from sim_mcm.arms.detents import CATCHES_M, CATCHES_RAD
from sim_mcm.control.executor import Executor
from tests.campaigns import RESULTS
from tests.workers.conftest import CELL, Bench, Physical

SEED = 7
ARM, MODULE, BAY = "RIGHT-ARM", "MACS-NEW", "BAY-2"
ERROR_M, ERROR_RAD = 0.002, np.radians(1.0)
BEFORE = (
    f"GRASP RIGHT-END-EFF {MODULE} HANDLE-A",
    f"LIFT {MODULE} BY 25 CM WITH {ARM}",
    f"MOVE {ARM} TO BAY-2-FRONT",
)
INSERT, PLACE = f"INSERT {MODULE} INTO {BAY} WITH {ARM}", f"PLACE {MODULE} ON {BAY} WITH {ARM}"


class Run(NamedTuple):
    seated: bool
    off_m: float  # from the seated place
    off_rad: float
    peak_n: float
    trims: int
    failed: str


class Inserter:
    """The arm with the module in its hand before the bay, and this state to return to."""

    def __init__(self) -> None:
        self.subsystem = Physical()
        self.bench = Bench(self.subsystem)
        self.sim = self.subsystem.sim
        for sentence in BEFORE:
            run = self.bench.do(sentence)
            assert run.succeeded, (sentence, run.refusal, run.assessments)
        self._law = p.ControlLaw(load=run.primitives[-1].control_law.load, gains=run.primitives[-1].control_law.gains)
        self._saved = pybullet.saveState(physicsClientId=self.sim.world.client)
        self._world = self.bench.world
        executor = self.subsystem.executors[ARM]
        self._joints, self._hand = list(executor._command[0]), executor._hand

    def run(self, offset: Array, rigid: bool) -> Run:
        """One insertion with the bay displaced by `offset` (x y z roll pitch yaw; m, rad)."""
        self._restore()
        world, home = self.sim.world, CELL.seat(BAY).frame.pose
        seat = world.seats[BAY]
        seat.home = geometry.compose(home, geometry.from_rpy(offset[:3], offset[3:]))
        world.place(seat, seat.home)
        done = self.bench.do(PLACE if rigid else INSERT)
        place = geometry.compose(seat.home, CELL.seat(BAY).module_frame.pose)
        pose = world.pose(MODULE)
        off_m, off_rad = geometry.distance(pose, place), geometry.angle(pose, place)
        seated = done.succeeded and off_m < CATCHES_M and off_rad < CATCHES_RAD and not self.sim.held()[ARM]
        why = done.failure or done.refusal
        peak_n = max((report.peak_force_n for report in done.reports[1:]), default=0.0)
        return Run(seated, off_m, off_rad, peak_n, len(done.trims), why.message if why else "")

    def _restore(self) -> None:
        """Back to the state before the first run: the world, and what its controller commands."""
        self.sim._detents.let_go_all()
        pybullet.restoreState(self._saved, physicsClientId=self.sim.world.client)
        self.bench.world = self._world
        still = [0.0] * len(self._joints)
        arm = self.sim.arms[ARM]
        arm.use_law(self._law)
        arm.follow((self._joints, still, still))
        arm.command_hand(self._hand)
        arm._hand.wanted_m = 0.0  # the spring of the grip is stretched
        for name, other in self.sim.arms.items():
            other.read()
            self.subsystem.executors[name] = Executor(other)
        self.subsystem.executors[ARM]._hand = self._hand


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--runs", type=int, default=100)
    words.add_argument("--rigid", action="store_true", help="position control instead, without results file")
    given = words.parse_args()
    question(
        "insert_sentence", f"does {'PLACE' if given.rigid else 'INSERT'} seat a module in a displaced seat?", seed=SEED
    )
    random = np.random.default_rng(SEED)
    inserter = Inserter()
    found: list[Run] = []
    for n in range(given.runs):
        offset = random.uniform(-1.0, 1.0, 6) * ([ERROR_M] * 3 + [ERROR_RAD] * 3)
        run = inserter.run(offset, given.rigid)
        found.append(run)
        if not run.seated or run.trims or n % 20 == 19:
            figures = ", ".join(f"{1e3 * x:.1f}" for x in offset)
            end = "seated" if run.seated else f"NOT seated, off {1e3 * run.off_m:.1f} mm, {run.off_rad:.3f} rad"
            print(f"  run {n}: {end}, {run.trims} trims, {run.peak_n:.0f} N; error {figures} {run.failed}", flush=True)
    seated = [run for run in found if run.seated]
    peaks = [run.peak_n for run in found]
    worst_mm = 1e3 * max((run.off_m for run in seated), default=0.0)
    rows = [
        ("seated", f"{len(seated)} of {given.runs}, {sum(not run.trims for run in seated)} at the first attempt"),
        ("peak of the wrist force", f"p50 {percentile(peaks, 50):.0f} N, worst {max(peaks):.0f} N"),
        ("distance from the seated place, of those seated", f"worst {worst_mm:.1f} mm"),
    ]
    if given.rigid:
        print(rows)
        return
    metrics = {"runs": float(given.runs), "seated": float(len(seated)), "peak_n": max(peaks)}
    finish("insert_sentence", metrics, rows, RESULTS)


if __name__ == "__main__":
    main()
