"""Do PLACE and INSERT seat a module from wherever the arm is, with either arm, handle and seat?

In physics, an arm has taken a module out of its rack by a handle. A sentence (MOVE ... TO JOINTS) carries it to a
random free posture; the postures are spread over the whole reach. Then one sentence, PLACE or INSERT, seats it in the
rack or in the bay. The runs take turns over the sixteen combinations of verb, seat, arm and handle. The age of the
grasp counts. A run succeeds if the command does and the truth of the simulator agrees: the module rests in the catch of
its seat, the hand is empty, nothing else has moved, and neither arm nor module has touched another body. A run that
reports a failure is true if the arm then holds still, and the module is in its hand or in the catch of a seat.

    python -m tests.campaigns.from_anywhere [--runs 64]
"""

from __future__ import annotations

import argparse
import itertools
import math
import multiprocessing
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pybullet

from benchmarks.report import percentile, question
from rtc.protocol.messages import Limits
from rtc.robot import geometry
from rtc.robot.geometry import Array
from sim_mcm.arms.detents import CATCHES_M, CATCHES_RAD, REST_M_S
from tests.campaigns import numbered_runs
from tests.campaigns.held_module import HeldModule
from tests.workers.conftest import CELL, MODEL
from tests.workers.conftest import Run as Done
from workers.planning.motion.request import PlanningRequest, free_posture
from workers.planning.motion.timing import Pace
from workers.planning.world_query import WorldQuery

SEED = 12
BAY = "BAY-2"
RACKS = {"RIGHT-ARM": ("MACS-NEW", "RACK-1"), "LEFT-ARM": ("MACS-OLD", "RACK-2")}
HANDLES = ("HANDLE-A", "HANDLE-B")
SENTENCES = {"PLACE": "PLACE {} ON {} WITH {}", "INSERT": "INSERT {} INTO {} WITH {}"}
MARGIN_RAD = 0.06  # of random postures from every joint limit
WATCHED = 10  # ticks between two looks for touches
MOVED_M = 0.0005  # of what should rest
SINCE_GRASP_S = 15.0  # age of the grasp at the start: a LIFT
AT_ONCE = 12  # random postures per run, of which the first is taken that a motion reaches


class Case(NamedTuple):
    verb: str
    bay: bool  # else the rack
    arm: str
    handle: str
    seed: int  # of the postures


class Run(NamedTuple):
    carried: int  # carries to the start: the last one reached it
    carry_failures: list[str]  # of the carries that had begun
    succeeded: bool  # as reported
    seated: bool  # by the simulator's truth
    off_m: float  # from the seated place
    off_rad: float
    peak_n: float  # of the wrist force, in the PLACE or INSERT
    touches: list[str]  # of arm and module with what they should not touch, in the whole run
    trims: int
    why: str
    true: bool


class Hand(HeldModule):
    """A module in the hand above its rack."""

    def __init__(self, arm: str, handle: str) -> None:
        module, self.rack = RACKS[arm]
        super().__init__(arm, module, (f"GRASP {module} {handle} WITH {arm}", f"LIFT {module} BY 15 CM"))
        self._touches: set[str] = set()
        self._seat = ""
        self.subsystem.disturb = self._watch

    def run(self, case: Case) -> Run:
        self.restore()
        self.bench.now_s = SINCE_GRASP_S
        self._touches.clear()
        self._seat = ""
        before = {name: self.sim.world.pose(name) for name in self.sim.world.movable if name != self.module}
        carried, failures = self._carry(np.random.default_rng(case.seed))
        self._seat = BAY if case.bay else self.rack
        done = self.bench.do(SENTENCES[case.verb].format(self.module, self._seat, self.arm))
        return self._judge(done, carried, failures, before)

    def _carry(self, random: np.random.Generator) -> tuple[int, list[str]]:
        """To a random posture; the number of sentences, and the failures of those that began."""
        failures: list[str] = []
        for n, joints in enumerate(itertools.islice(self._postures(random), AT_ONCE), 1):
            values = " ".join(f"{x:.3f}" for x in np.degrees(joints))
            done = self.bench.do(f"MOVE {self.arm} TO JOINTS {values} DEG")
            if done.succeeded:
                return n, failures
            if done.failure is not None:
                failures.append(done.failure.message)
                self.restore()
        raise AssertionError(f"{AT_ONCE} random postures of {self.arm} were not reached: {failures}")

    def _postures(self, random: np.random.Generator) -> Iterator[Array]:
        request = self._request()
        free, limits = free_posture(request), request.arm.limits
        while True:
            joints = random.uniform(limits.lower + MARGIN_RAD, limits.upper - MARGIN_RAD)
            if free(joints) is None:
                yield joints

    def _request(self) -> PlanningRequest:
        query = WorldQuery(MODEL, self.bench.world)
        return query.planning_request(self.arm, query.scene(self.arm, Limits()), Limits(), Pace(), MARGIN_RAD)

    def _watch(self, tick: int) -> None:
        """Before each step: time passes, and touches are noted."""
        self.bench.now_s += 0.001
        if tick % WATCHED:
            return
        world = self.sim.world
        module = world.objects[self.module].id
        arm = next(body for body, name in world.names.items() if name == self.arm)
        for first, second in ((module, arm), (arm, module)):
            for contact in pybullet.getContactPoints(first, physicsClientId=world.client):
                other = contact[2]
                name = world.names[other]
                may = second == other or other == first or (first == module and name.split()[0] == self._seat)
                if contact[8] <= 0.0 and contact[9] > 0.0 and not may:
                    self._touches.add(f"{world.names[first]} and {name}")

    def _judge(self, done: Done, carried: int, failures: list[str], before: dict[str, Array]) -> Run:
        world = self.sim.world
        place = CELL.seated_pose(self._seat)
        pose = world.pose(self.module)
        off_m, off_rad = geometry.distance(pose, place), geometry.angle(pose, place)
        rests = max(map(abs, world.velocity(self.module)[:3])) < REST_M_S
        caught = off_m < CATCHES_M and off_rad < CATCHES_RAD and self.module in self.sim._detents._caught
        moved = [name for name, was in before.items() if geometry.distance(world.pose(name), was) > MOVED_M]
        touches = [*sorted(self._touches), *(f"{name} was moved" for name in moved)]
        seated = rests and caught and not self.sim.held()[self.arm]
        why = done.failure or done.refusal
        return Run(
            carried=carried,
            carry_failures=failures,
            succeeded=done.succeeded,
            seated=seated,
            off_m=off_m,
            off_rad=off_rad,
            peak_n=max((report.peak_force_n for report in done.reports), default=0.0),
            touches=touches,
            trims=len(done.trims),
            why=why.message if why else "",
            true=seated if done.succeeded else self.holds_still(),
        )


def cases(seed: int) -> Iterator[Case]:
    """The sixteen combinations in turn, each time with other postures."""
    for n in itertools.count():
        for m, (verb, bay, arm, handle) in enumerate(itertools.product(SENTENCES, (False, True), RACKS, HANDLES)):
            yield Case(verb, bay, arm, handle, seed * 100_000 + 16 * n + m)


_hands: dict[tuple[str, str], Hand] = {}  # of a process, by arm and handle


def _run(case: Case) -> Run:
    key = case.arm, case.handle
    if key not in _hands:
        _hands[key] = Hand(*key)
    return _hands[key].run(case)


def _shared(asked: list[Case], processes: int) -> Iterator[Run]:
    """The runs in their order."""
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        yield from pool.imap(_run, asked)


def main() -> None:
    words = numbered_runs.arguments(__doc__, runs=64)
    words.add_argument("--seed", type=int, default=SEED, help="of other postures, without results file")
    words.add_argument("--processes", type=int, default=1, help="share the runs; each has scenes of its own")
    given = words.parse_args()
    question("from_anywhere", "do PLACE and INSERT seat a module from wherever the arm is?", seed=given.seed)
    found: list[Run] = []
    wanted = list(numbered_runs.chosen(given, cases(given.seed)))
    for (n, case), run in zip(wanted, _shared([case for _, case in wanted], given.processes), strict=True):
        found.append(run)
        where = BAY if case.bay else RACKS[case.arm][1]
        end = (
            "seated" if run.seated else f"NOT seated, off {1e3 * run.off_m:.1f} mm, {math.degrees(run.off_rad):.1f} deg"
        )
        print(
            f"  run {n}: {case.verb} {where} {case.arm} {case.handle}: {end}, {run.peak_n:.1f} N, {run.trims} trims,"
            f" {run.carried} carries {run.carry_failures or ''} {run.touches or ''} {run.why}"
            f"{'' if run.true else ' WRONG REPORT'}",
            flush=True,
        )
    _report(found, given)


def _report(found: list[Run], given: argparse.Namespace) -> None:
    good = [run for run in found if run.succeeded and run.seated and not run.touches]
    peaks = [run.peak_n for run in found]
    failures = [why for run in found for why in run.carry_failures]
    worst_mm = 1e3 * max((run.off_m for run in found if run.seated), default=0.0)
    rows = [
        ("seated, reported so, nothing else touched", f"{len(good)} of {len(found)}"),
        ("at the first attempt", f"{sum(run.trims == 0 for run in good)}"),
        ("peak of the wrist force", f"p50 {percentile(peaks, 50):.0f} N, worst {max(peaks):.0f} N"),
        ("distance from the seated place", f"worst {worst_mm:.1f} mm"),
        ("true reports", f"{sum(run.true for run in found)} of {len(found)}"),
        ("carries to the start that failed on the way", f"{len(failures)}"),
    ]
    metrics: dict[str, float | None] = {
        "runs": float(len(found)),
        "seated": float(len(good)),
        "true": float(sum(run.true for run in found)),
        "peak_n_p50": percentile(peaks, 50),
        "peak_n": max(peaks),
        "off_mm": worst_mm,
        "carries_failed": float(len(failures)),
    }
    numbered_runs.report("from_anywhere", metrics, rows, kept=not given.only and given.seed == SEED)


if __name__ == "__main__":
    main()
