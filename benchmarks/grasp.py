"""How well does a grasp locate a module that is far from its believed place, and what follows from it?

    python -m benchmarks.grasp [--runs 200] [--clusters 2] [--minutes 60] [--touch] [--short]

Each cluster makes two runs at a time, one with each arm. The modules are displaced with their seats, unknown to the
cluster. They move along one axis by up to 31 mm to either side, or by up to 4 deg of yaw. Or they move along all axes
at once (each up to 25 mm) with up to 4 deg of yaw. `--touch`: without cameras. Every second cluster has loads of 1.5
times the mass and pads with half the friction. A run grasps and lifts the module, and puts it back; every third run of
the right arm carries it to BAY-2. `--short`: the grasp alone. `--minutes`: no cluster is started after that time. After
a failure the advised sentences are submitted, with the true position; then the arm must stow.

    within_25_mm_rate     share of grasps in runs with x, y, z within 25 mm and yaw within 4 deg
    within_straddle_rate  the same, with x, y, z within 14 mm
    wrong_valid_facts     valid poses of a module, after any command, that are off by more than 5 mm or 2 deg
    outside_spread        valid frames, of any module or seat, whose truth lies outside their stated spread
    restless              arms that moved after a failed command
    stuck                 arms that the advised sentences did not free
    false_successes       PLACE that succeeded with the module more than 5 mm or 2 deg from its seat
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import random
import re
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec

from benchmarks.report import finish, question
from rtc.cells.cell import Cell
from rtc.client.client import Client
from rtc.demos.own_cluster import own_cluster
from rtc.protocol.messages import CommandEnded, Validity
from rtc.protocol.outcomes import OutcomeKind
from rtc.robot import geometry

SEED = 7
MODULES = {"RIGHT-ARM": ("MACS-NEW", "HANDLE-A", "RACK-1"), "LEFT-ARM": ("MACS-OLD", "HANDLE-B", "RACK-2")}
ALONG_M = (0.003, 0.008, 0.014, 0.023, 0.031)  # to either side, along one axis
ABOUT_RAD = tuple(math.radians(n) for n in (2.0, 4.0))
FAR_M, FAR_RAD = 0.025, math.radians(4.0)
STRADDLE_M = 0.014
WRONG_M, WRONG_RAD = 0.005, math.radians(2.0)
SEATED_M, SEATED_RAD = 0.005, math.radians(2.0)
HEAVY, SMOOTH = 1.5, 0.5
COMMAND_S = 300.0
BEYOND_M, BEYOND_RAD = 1e-4, 1e-3  # a truth this far outside a spread is a matter of rounding
REST_S, REST_RAD = 0.2, 1e-3  # an arm at rest turns by less in this time
ADVISED = re.compile(r"\b(LOCATE|LIFT|RETRACT|RELEASE|VERIFY|OPEN|STOW) ([A-Z0-9-]+(?: AT [A-Z0-9-]+| BY [0-9]+ CM)?)")


@dataclass
class GraspRun:
    """One module, one arm."""

    arm: str
    offset: list[float]
    heavy: bool
    into_bay: bool
    grasped: bool = False
    placed: bool = False
    wrong: list[str] = field(default_factory=list)  # wrong facts, as text
    outside: list[str] = field(default_factory=list)  # facts whose spread is too narrow, as text
    stuck: str = ""
    false_success: str = ""
    restless: str = ""
    failed: str = ""

    @property
    def within_straddle(self) -> bool:
        return self.within(STRADDLE_M)

    def within(self, most_m: float) -> bool:
        return max(map(abs, self.offset[:3])) <= most_m + 1e-9 and abs(self.offset[5]) <= FAR_RAD + 1e-9

    def in_words(self) -> str:
        x, y, z, _, _, yaw = self.offset
        where = f"{1e3 * x:+.0f} {1e3 * y:+.0f} {1e3 * z:+.0f} mm {math.degrees(yaw):+.0f} deg"
        how = f"{'grasped' if self.grasped else 'not grasped'}, {'placed' if self.placed else 'not placed'}"
        bad = [*self.wrong, *self.outside, *filter(None, (self.stuck, self.false_success, self.restless, self.failed))]
        return f"{self.arm} {'heavy ' if self.heavy else ''}{where}: {how} {'; '.join(bad)}"


def main() -> None:
    arguments = argparse.ArgumentParser(prog="python -m benchmarks.grasp", description=__doc__)
    arguments.add_argument("--runs", type=int, default=200)
    arguments.add_argument("--clusters", type=int, default=2, help="at a time")
    arguments.add_argument("--minutes", type=float, default=math.inf, help="start no cluster after this time")
    arguments.add_argument("--speed", default="max")
    arguments.add_argument("--seed", type=int, default=SEED)
    arguments.add_argument("--touch", action="store_true", help="without cameras; no results file")
    arguments.add_argument("--short", action="store_true", help="the grasp alone; no results file")
    given = arguments.parse_args()
    question("grasp", "How well does a grasp locate a module that is far from its believed place?", seed=given.seed)
    pairs = list(_pairs(given.runs, given.seed))
    done: list[GraspRun] = []
    context = multiprocessing.get_context("spawn")
    with TemporaryDirectory(prefix="rtc-grasp-") as folder, ProcessPoolExecutor(given.clusters, context) as pool:
        cell = _without_cameras(Path(folder)) if given.touch else "swapout"
        until = time.monotonic() + 60.0 * given.minutes
        work = partial(_cluster, given.speed, cell, given.short, until)
        for ended in as_completed([pool.submit(work, pair) for pair in pairs]):
            for run in ended.result():
                done.append(run)
                print(f"  {len(done)} of {given.runs}  {run.in_words()}", flush=True)
    _finish(done, given.touch or given.short)


def _without_cameras(folder: Path) -> str:
    """The file of the default cell without its cameras."""
    file = folder / "touch.yaml"
    file.write_bytes(msgspec.structs.replace(Cell.load("swapout"), name="touch", cameras=[]).encode())
    return str(file)


def _finish(done: list[GraspRun], partial_run: bool) -> None:
    straddled = [run for run in done if run.within_straddle]
    near = [run for run in done if run.within(FAR_M)]
    metrics: dict[str, float | None] = {
        "runs": len(done),
        "successes": sum(run.grasped for run in done),
        "within_25_mm": len(near),
        "within_25_mm_rate": sum(run.grasped for run in near) / len(near) if near else None,
        "within_straddle_rate": sum(run.grasped for run in straddled) / len(straddled) if straddled else None,
        "wrong_valid_facts": sum(len(run.wrong) for run in done),
        "outside_spread": sum(len(run.outside) for run in done),
        "stuck": sum(bool(run.stuck) for run in done),
        "restless": sum(bool(run.restless) for run in done),
        "false_successes": sum(bool(run.false_success) for run in done),
        "placed": sum(run.placed for run in done),
    }
    if partial_run:
        print(metrics)
        return
    finish("grasp", metrics)


def _pairs(runs: int, seed: int) -> Iterator[list[GraspRun]]:
    """Two runs for each cluster, one per arm; the offsets repeat in a cycle."""
    rng = random.Random(seed)
    offsets = _offsets(rng)
    for n in range((runs + 1) // 2):
        heavy = n % 2 == 0
        pair = [
            GraspRun("RIGHT-ARM", next(offsets), heavy, n % 3 == 2),
            GraspRun("LEFT-ARM", next(offsets), heavy, False),
        ]
        yield pair[: runs - 2 * n]


def _offsets(rng: random.Random) -> Iterator[list[float]]:
    """Endless offsets x y z roll pitch yaw: alternately on a single axis, and on all axes."""
    singles = [
        [sign * size if axis == n else 0.0 for n in range(6)]
        for axis, sizes in ((0, ALONG_M), (1, ALONG_M), (2, ALONG_M), (5, ABOUT_RAD))
        for size in sizes
        for sign in (1, -1)
    ]
    while True:
        rng.shuffle(singles)
        for single in singles:
            yield list(single)
            all_m = [rng.uniform(-FAR_M, FAR_M) for _ in range(3)]
            yield [*all_m, 0.0, 0.0, rng.uniform(-FAR_RAD, FAR_RAD)]


# --- one cluster -------------------------------------------------------------------------------------------


def _cluster(speed: str, cell_name: str, short: bool, until: float, runs: list[GraspRun]) -> list[GraspRun]:
    """The finished runs; none after the time `until` of this machine."""
    if time.monotonic() > until:
        return []
    with own_cluster(cell=cell_name, speed=speed) as run_dir, Client(run_dir) as rtc:
        if runs[0].heavy:
            rtc.change_physics(HEAVY, SMOOTH)
        for run in runs:
            rtc.displace(MODULES[run.arm][0], run.offset)
        cell = Cell.load(rtc.settings.cell)
        seated = {arm: rtc.truth().poses[module] for arm, (module, _, _) in MODULES.items()}
        grasps = [
            f"GRASP {cell.arm(run.arm).end_effector} {module} {point}"
            for run in runs
            for module, point, _ in [MODULES[run.arm]]
        ]
        for run, ended in zip(runs, rtc.run_many(grasps, timeout_s=COMMAND_S), strict=True):
            run.grasped = _good(ended)
            _judge(rtc, run)
            if not short or not run.grasped:
                _chain(rtc, cell, run, ended, seated[run.arm])
    return runs


def _chain(rtc: Client, cell: Cell, run: GraspRun, ended: CommandEnded, rack: list[float]) -> None:
    """The commands after a grasp: lift, carry, put down; or the advised ones after a failure."""
    module, _, seat = MODULES[run.arm]
    target = "BAY-2" if run.into_bay else seat
    ways = [f"MOVE {run.arm} TO CLEAR-POINT-1", f"MOVE {run.arm} TO BAY-2-FRONT"] if run.into_bay else []
    sentences = [f"LIFT {module} BY 15 CM WITH {run.arm}", *ways, f"PLACE {module} ON {target}"]
    for text in sentences:
        if not _good(ended):
            break
        ended = rtc.run(text, timeout_s=COMMAND_S)
        _judge(rtc, run)
    if not _good(ended):
        run.failed = f"{ended.text}: {ended.outcome.kind.value}, {ended.outcome.message[:160]}"
        run.restless = _restless(rtc, run.arm)
        run.stuck = _freed(rtc, run, ended)
        return
    run.placed = True
    place = cell.seated_pose(target).tolist() if run.into_bay else rack
    off = geometry.relative(place, rtc.truth().poses[module])
    away_m, turned = math.hypot(*off[:3].tolist()), geometry.angle(geometry.IDENTITY, off)
    if away_m > SEATED_M or turned > SEATED_RAD:
        run.false_success = f"placed {1e3 * away_m:.1f} mm, {math.degrees(turned):.1f} deg from {target}"


def _good(ended: CommandEnded) -> bool:
    return ended.outcome.kind is OutcomeKind.SUCCEEDED


def _judge(rtc: Client, run: GraspRun) -> None:
    """Compare the valid frames of the modules and seats with their true poses."""
    truth = rtc.truth()
    true = {f"{name}.frame": pose for name, pose in (truth.poses | truth.seats).items()}
    for fact in rtc.world.view(keys=list(true)).facts:
        if fact.validity is not Validity.VALID:
            continue
        off = geometry.relative(fact.value, true[fact.key])
        away_m, turned = math.hypot(*off[:3].tolist()), geometry.angle(geometry.IDENTITY, off)
        words = f"{fact.key} off by {1e3 * away_m:.1f} mm, {math.degrees(turned):.1f} deg since {fact.source}"
        if fact.key == f"{MODULES[run.arm][0]}.frame" and (away_m > WRONG_M or turned > WRONG_RAD):
            run.wrong.append(f"valid and {words}")
        errors = [*off[:3].tolist(), *geometry.to_rpy(off).tolist()]
        if fact.spread is not None and not within(errors, fact.spread):
            run.outside.append(f"outside its spread: {words}")


def within(errors: Sequence[float], spread: Sequence[float]) -> bool:
    """Whether errors x y z roll pitch yaw (m, rad) are within a spread."""
    room = [BEYOND_M] * 3 + [BEYOND_RAD] * 3
    return all(abs(error) <= most + more for error, most, more in zip(errors, spread, room, strict=True))


def _restless(rtc: Client, arm: str) -> str:
    """The motion of an arm that should rest; empty if it does."""
    before = rtc.truth().joints[arm]
    time.sleep(REST_S)
    turned = max(abs(a - b) for a, b in zip(before, rtc.truth().joints[arm], strict=True))
    return f"MOVES by {turned:.4f} rad in {REST_S:g} s" if turned > REST_RAD else ""


def _freed(rtc: Client, run: GraspRun, ended: CommandEnded) -> str:
    """Submit the advised sentences with true positions, then stow. Returns the refusals; empty if it stowed."""
    module = MODULES[run.arm][0]
    results = [ended.outcome.message]
    for _ in range(3):
        clears = ended.outcome.refusal.clears if ended.outcome.refusal else ""
        for text in _advised(clears, rtc, module):
            results.append(f"{text}: {rtc.run(text, timeout_s=COMMAND_S).outcome.kind.value}")
        ended = rtc.run(f"STOW {run.arm}", timeout_s=COMMAND_S)
        if _good(ended):
            return ""
        results.append(f"{ended.text}: {ended.outcome.message}")
    return f"STUCK: {' | '.join(results)[:600]}"


def _advised(clears: str, rtc: Client, module: str) -> Iterator[str]:
    if f"SET {module} FRAME" in clears:
        x, y, z = (100.0 * n for n in rtc.truth().poses[module][:3])
        yield f"SET {module} FRAME {x:.2f} {y:.2f} {z:.2f} CM"
    for verb, rest in ADVISED.findall(clears):
        yield f"{verb} {rest}"


if __name__ == "__main__":
    main()
