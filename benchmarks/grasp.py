"""How well does a grasp locate a module that is far from its believed place, and what follows from it?

    python -m benchmarks.grasp [--runs 300] [--seed-from 0] [--processes 2] [--cameras-only | --touch-only] [--short]
    python -m benchmarks.grasp --join results-a.json results-b.json ...

In physics, sentence by sentence in one process, without a broker. The module and its seat are displaced along and about
all six axes, by up to 25 mm and 4 degrees; the world believes them within what the cell file states. The runs take
turns over both arms, both handles, rack and bay, three masses, three frictions, with and without cameras. Every fourth
displacement is along or about one axis alone. One is halved if the module would overlap another body, or if its
straight way out of its seat would come nearer than 5 mm to one: the seat is displaced, the satellite around it is not.
A run grasps the module, lifts it, and puts it back; every third run puts it into the other seat. After each sentence
all valid facts are compared with the truth. After a failure the advised sentences are given, at most four of them; SET
states the true pose. Then the failed sentence must succeed, or another obstacle be named, and so on: the same advice
twice, or four obstacles, are stuck. What the true scene does not allow is counted apart.
`--short`: the grasp alone. A shard (`--seed-from`) writes its runs into a file (`--out`), after each run;
`--join` adds shards up.

    within_straddle_rate  share of grasps in runs with x, y, z within 14 mm
    wrong_valid_facts     valid facts that are off by more than 5 mm or 2 deg beyond their spread
    outside_spread        valid poses whose truth lies outside their stated spread
    stuck                 failures that their advice did not clear
    infeasible            sentences that the planner refuses with the true poses
    restless              arms that moved after a failed command
    false_successes       PLACE that succeeded with the module more than 5 mm or 2 deg from its seat
"""

from __future__ import annotations

import argparse
import functools
import itertools
import json
import math
import multiprocessing
import random
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import pybullet

from benchmarks.report import finish, question
from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import RefusalReason
from rtc.spatial import geometry
from tests.campaigns import advice
from tests.campaigns.advice import Answer
from tests.campaigns.against_truth import judge
from tests.workers.conftest import CELL, Bench, Physical, Run
from workers.planning.robot_models import CellModel
from workers.planning.scenes import CLEARANCE_M

SEED = 7
MODULES = {"RIGHT-ARM": ("MACS-NEW", "RACK-1"), "LEFT-ARM": ("MACS-OLD", "RACK-2")}
BAY = "BAY-2"
HANDLES = ("HANDLE-A", "HANDLE-B")
MASSES, FRICTIONS = (1.0, 1.5, 0.5), (1.0, 0.5, 1.5)
FAR_M, FAR_RAD = 0.025, math.radians(4.0)
STRADDLE_M = 0.014
NARROW_M = 0.010
SEATED_M, SEATED_RAD = 0.005, math.radians(2.0)
REST_TICKS, REST_RAD = 200, 1e-3  # an arm at rest turns by less in this time
SETTLE_TICKS, SETTLE_M = 100, 1e-4
WAY_STEP_M = 0.01


@dataclass
class GraspRun:
    """One module and one arm, and how it went."""

    number: int
    arm: str
    handle: str
    bay: bool
    other: bool  # it is put into the other seat
    cameras: bool
    mass: float
    friction: float
    offset: list[float]
    grasped: bool = False
    placed: bool = False
    checked: int = 0
    wrong: list[str] = field(default_factory=list)
    outside: list[str] = field(default_factory=list)
    failed: str = ""
    stuck: str = ""
    infeasible: str = ""
    restless: str = ""
    false_success: str = ""
    trims: int = 0
    seconds: float = 0.0

    @property
    def within_straddle(self) -> bool:
        return self.within(STRADDLE_M)

    def within(self, most_m: float) -> bool:
        return max(map(abs, self.offset[:3])) <= most_m + 1e-9

    @property
    def bad(self) -> bool:
        return bool(self.wrong or self.outside or self.stuck or self.restless or self.false_success)

    def in_words(self) -> str:
        x, y, z, roll, pitch, yaw = self.offset
        where = f"{1e3 * x:+.0f} {1e3 * y:+.0f} {1e3 * z:+.0f} mm "
        where += f"{math.degrees(roll):+.1f} {math.degrees(pitch):+.1f} {math.degrees(yaw):+.1f} deg"
        scene = f"{self.arm} {self.handle} in {BAY if self.bay else 'its rack'}{' to the other seat' * self.other}"
        how = f"{'grasped' if self.grasped else 'NOT grasped'}, {'placed' if self.placed else 'not placed'}"
        labels = ("WRONG", self.wrong), ("OUTSIDE", self.outside)
        bad = [f"{label} {len(found)}: {found[0]}" for label, found in labels if found]
        names = ("failed", "stuck", "infeasible", "restless", "false_success")
        bad += [f"{name.upper()}: {text}" for name in names if (text := getattr(self, name))]
        return (
            f"run {self.number}: {scene}, {'cameras' if self.cameras else 'touch'}, mass {self.mass:g} "
            f"friction {self.friction:g}, {where}: {how}, {self.trims} trims, {self.seconds:.1f} s"
            + "".join(f"\n      {one}" for one in bad)
        )


def runs(count: int, first: int = 0, seed: int = SEED) -> Iterator[GraspRun]:
    """The runs of these numbers; a number always has the same conditions."""
    cases = list(itertools.product(MODULES, HANDLES, (False, True), (False, True), MASSES, FRICTIONS))
    random.Random(seed).shuffle(cases)
    for n in range(first, first + count):
        rng = random.Random(f"{seed}/{n}")
        arm, handle, bay, cameras, mass, friction = cases[n % len(cases)]
        offset = [rng.uniform(-1.0, 1.0) * most for most in [FAR_M] * 3 + [FAR_RAD] * 3]
        if n % 4 == 3:
            axis = rng.randrange(6)
            offset = [rng.choice((-1.0, 1.0)) * (FAR_M if k < 3 else FAR_RAD) * (k == axis) for k in range(6)]
        yield GraspRun(n, arm, handle, bay, n % 3 == 2, cameras, mass, friction, offset)


@functools.cache
def _model(arm: str, bay: bool, cameras: bool) -> CellModel:
    """The default cell, with the module of the arm in its rack or in the bay."""
    module = MODULES[arm][0]
    objects = [msgspec.structs.replace(one, seat=BAY) if bay and one.name == module else one for one in CELL.objects]
    return CellModel(msgspec.structs.replace(CELL, objects=objects, cameras=CELL.cameras if cameras else []))


# --- one run ---------------------------------------------------------------------------------------------------


class Scene:
    """The simulated cell of one run."""

    def __init__(self, run: GraspRun) -> None:
        self.run = run
        self.model = _model(run.arm, run.bay, run.cameras)
        self.module, self.rack = MODULES[run.arm]
        self.seat = BAY if run.bay else self.rack
        self._set_up()
        while self._is_pushed_out() or self._is_shut_in():
            self.subsystem.close()
            run.offset = [0.5 * part for part in run.offset]
            self._set_up()

    def _set_up(self) -> None:
        run = self.run
        self.subsystem = Physical(self.cell)
        self.bench = Bench(self.subsystem, self.model)
        self.bench.unsurveyed()
        self.sim = self.subsystem.sim
        self.sim.change_physics(run.mass, run.friction)
        self.subsystem.displace_and_turn(self.module, list(run.offset))

    def _is_pushed_out(self) -> bool:
        """Whether the displaced module overlaps another body: physics pushes it out of its seat at once."""
        before = self.truth()["poses"][self.module]
        for _ in range(SETTLE_TICKS):
            self.sim.step()
        return geometry.distance(before, self.truth()["poses"][self.module]) > SETTLE_M

    def _is_shut_in(self) -> bool:
        """Whether another body than its seat is in the straight way of the module out of the seat."""
        world, seat = self.sim.world, self.cell.seat(self.seat)
        here = world.pose(self.module)
        out = geometry.rotate(geometry.compose(here, geometry.inverse(seat.module_frame.pose)), seat.way_out)
        module = world.objects[self.module]
        others = [part for name, body in world.objects.items() if name != self.module for part, _ in body.parts]
        near = False
        for n in range(math.ceil(seat.depth_m / WAY_STEP_M) + 1):
            world.place(module, geometry.translate(here, n * WAY_STEP_M * out))
            near = near or any(self._distance_m(module.parts[0][0], other) < CLEARANCE_M for other in others)
        world.place(module, here)
        return near

    def _distance_m(self, body: int, other: int) -> float:
        """The distance of two bodies in physics; beyond 10 cm infinite."""
        points = pybullet.getClosestPoints(body, other, 0.1, physicsClientId=self.sim.world.client)
        return min((point[8] for point in points), default=math.inf)

    @property
    def cell(self) -> Cell:
        return self.model.cell

    def truth(self) -> dict[str, Any]:
        return {**self.sim.truth(), "held": self.sim.held()}

    def do(self, text: str) -> Run:
        done = self.bench.do(text)
        self.run.trims += len(done.trims)
        found = judge(self.bench.world.facts.values(), self.truth())
        self.run.checked += found.checked
        self.run.wrong += [f"after {text}: {one}" for one in found.wrong]
        self.run.outside += [f"after {text}: {one}" for one in found.outside]
        return done

    def stated(self) -> Iterator[str]:
        """The sentences that state where module and seats are."""
        for name in (self.module, self.rack, BAY):
            yield advice.stated(name, self.truth())

    def rests(self) -> bool:
        before = self.sim.arms[self.run.arm].read().joints
        for _ in range(REST_TICKS):
            self.subsystem.tick()
        after = self.sim.arms[self.run.arm].read().joints
        return max(abs(a - b) for a, b in zip(before, after, strict=True)) < REST_RAD


def perform(run: GraspRun, short: bool = False) -> GraspRun:
    """Make the run."""
    began = time.monotonic()
    scene = Scene(run)
    try:
        _chain(scene, short)
    finally:
        scene.subsystem.close()
    run.seconds = time.monotonic() - began
    return run


def _chain(scene: Scene, short: bool) -> None:
    run, module = scene.run, scene.module
    target = scene.rack if run.other and run.bay else BAY if run.other else scene.seat
    if run.bay and not run.within(NARROW_M):
        target = scene.rack  # in a bay that is farther off, the module would meet the frame of the satellite
    sentences = [f"GRASP {module} {run.handle} WITH {run.arm}"]
    if not short:
        out_cm = 30 if run.bay else 20
        sentences += [f"LIFT {module} BY {out_cm} CM WITH {run.arm}", f"PLACE {module} ON {target} WITH {run.arm}"]
    for n, text in enumerate(sentences):
        done = scene.do(text)
        if done.succeeded and n == 0:
            run.grasped = scene.truth()["held"][run.arm] == [module]
        if not done.succeeded and not _cleared(scene, text, done):
            return
    if short:
        return
    run.placed = True
    truth = scene.truth()
    seated = geometry.compose(truth["seats"][target], scene.cell.seat(target).module_frame.pose)
    off_m, off_rad = geometry.distance(seated, truth["poses"][module]), geometry.angle(seated, truth["poses"][module])
    if off_m > SEATED_M or off_rad > SEATED_RAD:
        run.false_success = f"placed {1e3 * off_m:.1f} mm, {math.degrees(off_rad):.1f} deg from {target}"


def _cleared(scene: Scene, text: str, done: Run) -> bool:
    """Whether a failed sentence succeeds after its advice."""
    run = scene.run
    answer = Answer.of(done)
    run.failed = run.failed or f"{text}: {answer}"
    run.restless = run.restless or ("" if scene.rests() else f"after {text}")
    last = done

    def say(sentence: str) -> Answer:
        nonlocal last
        last = scene.do(sentence)
        return Answer.of(last)

    followed = advice.follow(say, text, answer, scene.truth)
    if followed.end == "reached":
        return True
    story = " | ".join(followed.history)
    if last.refusal is not None and last.refusal.reason is RefusalReason.INFEASIBLE and _is_infeasible(scene, text):
        run.infeasible = story
    else:
        run.stuck = story
    return False


def _is_infeasible(scene: Scene, text: str) -> bool:
    """Whether the planner refuses the sentence with the true pose of the module."""
    for sentence in scene.stated():
        scene.do(sentence)
    why = scene.do(text).refusal
    return why is not None and why.reason is RefusalReason.INFEASIBLE


# --- all runs --------------------------------------------------------------------------------------------------


def wilson(successes: int, count: int) -> tuple[float, float]:
    """The Wilson interval of 95 % of a rate."""
    if not count:
        return 0.0, 1.0
    z, rate = 1.96, successes / count
    middle = (rate + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * math.sqrt(rate * (1 - rate) / count + z * z / (4 * count * count))
    return max(0.0, middle - half), min(1.0, middle + half)


def metrics_of(done: Sequence[GraspRun]) -> dict[str, float | None]:
    straddled = [run for run in done if run.within_straddle]
    grasped = sum(run.grasped for run in done)
    low, high = wilson(grasped, len(done))
    rates = {}
    for name, ones in (("cameras", [r for r in done if r.cameras]), ("touch", [r for r in done if not r.cameras])):
        rates[f"{name}_rate"] = sum(run.grasped for run in ones) / len(ones) if ones else None
    return {
        "runs": len(done),
        "successes": grasped,
        "success_low": round(low, 4),
        "success_high": round(high, 4),
        **rates,
        "within_straddle_rate": sum(run.grasped for run in straddled) / len(straddled) if straddled else None,
        "facts_checked": sum(run.checked for run in done),
        "wrong_valid_facts": sum(len(run.wrong) for run in done),
        "outside_spread": sum(len(run.outside) for run in done),
        "stuck": sum(bool(run.stuck) for run in done),
        "infeasible": sum(bool(run.infeasible) for run in done),
        "restless": sum(bool(run.restless) for run in done),
        "false_successes": sum(bool(run.false_success) for run in done),
        "placed": sum(run.placed for run in done),
        "seconds_per_run": sum(run.seconds for run in done) / len(done) if done else None,
    }


def main() -> None:
    words = argparse.ArgumentParser(
        prog="python -m benchmarks.grasp", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    words.add_argument("--runs", type=int, default=300)
    words.add_argument("--seed-from", type=int, default=0, help="number of the first run")
    words.add_argument("--only", type=int, nargs="+", help="these runs alone")
    words.add_argument("--processes", type=int, default=2)
    words.add_argument("--cameras-only", action="store_true")
    words.add_argument("--touch-only", action="store_true")
    words.add_argument("--short", action="store_true", help="the grasp alone")
    words.add_argument("--out", type=Path, help="write the runs into this file instead of the results")
    words.add_argument("--join", type=Path, nargs="+", help="report the runs of these files")
    given = words.parse_args()
    question("grasp", "How well does a grasp locate a module that is far from its believed place?", seed=SEED)
    if given.join:
        rows = [row for file in given.join for row in json.loads(file.read_text())]
        done = list({row["number"]: GraspRun(**row) for row in rows}.values())
    else:
        done = []
        for run in _made(list(_wanted(given)), given.processes, given.short):
            done.append(run)
            if given.out:  # after each run: a series that is ended early keeps its results
                _write(given.out, done)
    if given.join or not (given.out or given.only or given.cameras_only or given.touch_only or given.short):
        finish("grasp", metrics_of(done))
    else:
        print(json.dumps(metrics_of(done)))


def _wanted(given: argparse.Namespace) -> Iterator[GraspRun]:
    if given.only:
        yield from (next(runs(1, n)) for n in given.only)
        return
    for run in runs(given.runs, given.seed_from):
        if (run.cameras or not given.cameras_only) and not (run.cameras and given.touch_only):
            yield run


def _write(file: Path, done: Sequence[GraspRun]) -> None:
    """Replace the file at once, so that it is never half written."""
    part = file.with_name(file.name + ".part")
    part.write_text(json.dumps([asdict(run) for run in done]))
    part.replace(file)


def _made(wanted: Sequence[GraspRun], processes: int, short: bool) -> Iterator[GraspRun]:
    began = time.monotonic()
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        for n, run in enumerate(pool.imap_unordered(functools.partial(perform, short=short), wanted), 1):
            print(f"  {n}/{len(wanted)} in {time.monotonic() - began:.0f} s: {run.in_words()}", flush=True)
            yield run


if __name__ == "__main__":
    main()
