"""Does MATE tell a latch that clicks and holds from one that does not, whatever masses, friction and the socket are?

A plug in the hand of the right arm is mated with a socket that is up to 1 mm and 0.5 degrees off, which nothing knows.
Masses and the friction of the pads are varied. Each run is made with a whole latch, with one that does not resist, and
with one that clicks and holds nothing. Printed: what the thresholds of `workers.mechanisms.connectors` divide.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from benchmarks.report import question
from rtc.model.cells.cell import Cell
from rtc.spatial import geometry
from tests.workers.conftest import Bench, Physical, Run
from workers.planning.robot_models import CellModel

ARM, PLUG, SOCKET = "RIGHT-ARM", "PLUG-1", "SOCKET-1"
TAKEN = (f"GRASP {PLUG}", f"LIFT {PLUG} BY 15 CM")
MATE, DEMATE = f"MATE {PLUG} TO {SOCKET}", f"DEMATE {PLUG}"
OFF_M, OFF_RAD = 0.001, math.radians(0.5)
WHOLE, NO_CLICK, NO_HOLD = LATCHES = ("whole", "no click", "no hold")
PHYSICS = ((0.9, 0.8), (1.1, 1.0), (0.9, 1.2), (1.1, 0.8), (0.9, 1.0), (1.1, 1.2))  # factors of mass and friction


def with_latch(cell: Cell, latch: str) -> Cell:
    """The cell as it is in truth: with a latch that does not resist, or not hold."""
    seats = []
    for seat in cell.seats:
        if seat.mating is not None and latch != WHOLE:
            latch_n = 0.0 if latch == NO_CLICK else seat.mating.latch_n
            seat = replace(seat, mating=replace(seat.mating, latch_n=latch_n, holds_n=1e-7), detent_n=1e-6)
        seats.append(seat)
    return replace(cell, seats=seats)


def in_hand(latch: str = WHOLE) -> Bench:
    """With physics: the plug in the right hand, out of its stand."""
    cell = Cell.load("connectors")
    bench = Bench(Physical(with_latch(cell, latch)), CellModel(cell))
    for sentence in TAKEN:
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.failure)
    return bench


def displace(bench: Bench, offset: Sequence[float]) -> None:
    """Put the socket elsewhere (m, rad), which nothing knows."""
    world = bench.subsystem.sim.world
    seat = world.seats[SOCKET]
    seat.home = geometry.compose(seat.home, geometry.from_rpy(offset[:3], offset[3:]))
    world.place(seat, seat.home)


def measured(bench: Bench, run: Run) -> list[str]:
    """Of each step that presses or tugs: its peak, and how far from its goal it ended."""
    fk = bench.model.arms[ARM].fk
    found = []
    for primitive, report in list(zip(run.primitives, run.reports, strict=True))[3:]:
        off_mm = 1e3 * geometry.distance(report.tcp_pose, fk(primitive.trajectory.positions[-1]))
        found.append(f"{report.reason.value}, peak {report.peak_force_n:.1f} N, {off_mm:.2f} mm from the goal")
    return found


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--runs", type=int, default=6, help="of each latch")
    words.add_argument("--seed", type=int, default=1)
    given = words.parse_args()
    question("connectors", "Does MATE tell a latch that clicks and holds from one that does not?", seed=given.seed)
    random = np.random.default_rng(given.seed)
    for n, (mass, friction) in zip(range(given.runs), itertools.cycle(PHYSICS), strict=False):
        offset = random.uniform(-1.0, 1.0, 6) * ([OFF_M] * 3 + [OFF_RAD] * 3)
        for latch in LATCHES:
            bench = in_hand(latch)
            bench.subsystem.sim.change_physics(mass, friction)
            displace(bench, offset)
            run = bench.do(MATE)
            assert run.refusal is None, run.refusal
            print(f"{n} {latch}, mass {mass}, friction {friction}: {measured(bench, run)}")
            print(f"    {run.failure.message if run.failure else bench.world.value(f'{PLUG}.mating')}", flush=True)
            if run.succeeded:
                peaks = [round(report.peak_force_n, 1) for report in bench.do(DEMATE).reports]
                print(f"    DEMATE: peaks {peaks} N, {bench.world.value(f'{PLUG}.mating')}", flush=True)
            bench.subsystem.close()


if __name__ == "__main__":
    main()
