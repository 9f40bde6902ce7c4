"""Do PLACE and INSERT seat a module from wherever the arm is, and does nothing touch anything on the way?

In physics, an arm has taken a module out of its rack by a handle, where it was displaced. Sentences (MOVE) carry it by
places and random free postures, which are spread over the whole reach. Then one sentence, PLACE or INSERT, seats it in
the rack or in the bay. Arm, handle, grasp, vias, verb and seat are drawn at random. The age of the grasp counts.

A run succeeds if the command does and the truth of the simulator agrees: the module rests in the catch of its seat, the
hand is empty, nothing else has moved, and neither arm nor module has touched another body. A run that reports a failure
is true if the arm then holds still, and the module is in its hand or in the catch of a seat. On all ways but the
straight ones into a seat and out of it, the forces between arm or module and any other body are summed in every tick:
at most 5 N.

    python -m tests.campaigns.from_anywhere [--runs 300] [--processes 2]
    python -m tests.campaigns.from_anywhere --first 100 --runs 200 --part b.json   # a shard: runs 100 to 199
    python -m tests.campaigns.from_anywhere --join a.json b.json c.json            # the results of all shards
"""

from __future__ import annotations

import itertools
import math
import multiprocessing
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import pybullet

from benchmarks.report import percentile, question
from rtc.protocol.messages import BoundStep, EndReport, Limits
from rtc.protocol.primitive import JointTrajectory, Primitive
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from sim_mcm.arms.detents import CATCHES_M, CATCHES_RAD, REST_M_S
from tests.campaigns import advice, numbered_runs
from tests.campaigns.held_module import HeldModule
from tests.workers.conftest import CELL, MODEL
from tests.workers.conftest import Run as Done
from workers.planning import scenes
from workers.planning.motion.request import PlanningRequest, free_posture
from workers.planning.motion.timing import SpeedLimits
from workers.planning.world_query import WorldQuery

SEED = 12
BAY = "BAY-2"
RACKS = {"RIGHT-ARM": ("MACS-NEW", "RACK-1"), "LEFT-ARM": ("MACS-OLD", "RACK-2")}
HANDLES = ("HANDLE-A", "HANDLE-B")
SENTENCES = {"PLACE": "PLACE {} ON {} WITH {}", "INSERT": "INSERT {} INTO {} WITH {}"}
MARGIN_RAD = 0.06  # of random postures from every joint limit
MOVED_M = 0.0005  # of what should rest
SINCE_GRASP_S = 15.0  # age of the grasp at the start: a LIFT
AT_ONCE = 12  # random postures per via, of which the first is taken that a motion reaches
GRASPS = 3  # different ones for each arm and handle
OFF_M, OFF_RAD = 0.001, 0.008  # of the module in the play of its rack before the grasp
MAX_VIAS = 3
MAX_N = 5.0  # between arm or module and any other body, on a free way


class Case(NamedTuple):
    verb: str
    bay: bool  # else the rack
    arm: str
    handle: str
    grasp: int  # number of the drawn one
    vias: tuple[str, ...]  # places; empty text: a random posture
    seed: int  # of the postures


class Run(NamedTuple):
    carried: int  # carries to the start
    carry_failures: list[str]  # of the carries that had begun
    refused: list[str]  # carries that were refused, without motion
    succeeded: bool  # as reported
    seated: bool  # by the simulator's truth
    off_m: float  # from the seated place
    off_rad: float
    free_n: float  # between arm or module and any other body, on free ways: the greatest sum in one tick
    wrist_n: float  # at the wrist, on free ways
    peak_n: float  # of the wrist force, in the PLACE or INSERT
    touches: list[str]  # of arm and module with what they should not touch, in the whole run
    trims: int
    why: str
    true: bool
    after: str = ""  # what the advice of a failure led to


class Hand(HeldModule):
    """A module in the hand above its rack."""

    def __init__(self, arm: str, handle: str, grasp: int) -> None:
        module, self.rack = RACKS[arm]
        random = np.random.default_rng((SEED, grasp))
        off = random.uniform(-1.0, 1.0, 6) * ((OFF_M, OFF_M, 0.0, 0.0, 0.0, OFF_RAD) if grasp else (0.0,) * 6)
        sentences = (f"GRASP {module} {handle} WITH {arm}", f"LIFT {module} BY 15 CM")
        super().__init__(arm, module, sentences, offset=off.tolist())
        self._touches: set[str] = set()
        self._seat = ""
        self._free = False  # the motion is a free one
        self._free_n = self._wrist_n = 0.0
        self.subsystem.disturb = self._watch
        perform = self.subsystem.perform

        def watched(made: Primitive, bound: BoundStep) -> EndReport:
            assert bound.evaluation is not None
            self._free = isinstance(made.trajectory, JointTrajectory) and bound.evaluation.step.space == "move_joint"
            return perform(made, bound)

        self.subsystem.perform = watched  # type: ignore[method-assign]

    def run(self, case: Case) -> Run:
        self.restore()
        self.bench.now_s = SINCE_GRASP_S
        self._touches.clear()
        self._seat, self._free_n, self._wrist_n = "", 0.0, 0.0
        before = {name: self.sim.world.pose(name) for name in self.sim.world.movable if name != self.module}
        random, refused, failures, carried = np.random.default_rng(case.seed), [], [], 0
        for via in case.vias:
            done = self.bench.do(f"MOVE {self.arm} TO {via}") if via else self._anywhere(random)
            carried += done.succeeded
            if done.failure is not None:
                failures.append(done.failure.message)
                break
            if not done.succeeded:
                refused.append(done.refusal.message if done.refusal else "")
        self._seat = BAY if case.bay else self.rack
        sentence = SENTENCES[case.verb].format(self.module, self._seat, self.arm)
        done = self.bench.do(sentence)
        judged = self._judge(done, carried, failures, refused, before)
        if done.succeeded:
            return judged
        followed = advice.follow_on_bench(self.bench, sentence, done)
        return judged._replace(after=f"{followed.end}: {' | '.join(followed.history)}")

    def _anywhere(self, random: np.random.Generator) -> Done:
        """To a random posture: the first of some that is reached."""
        for joints in itertools.islice(self._postures(random), AT_ONCE):
            values = " ".join(f"{x:.3f}" for x in np.degrees(joints))
            done = self.bench.do(f"MOVE {self.arm} TO JOINTS {values} DEG")
            if done.succeeded or done.failure is not None:
                break
        return done

    def _postures(self, random: np.random.Generator) -> Iterator[Array]:
        request = self._request()
        free, limits = free_posture(request), request.arm.limits
        while True:
            joints = random.uniform(limits.lower + MARGIN_RAD, limits.upper - MARGIN_RAD)
            if free(joints) is None:
                yield joints

    def _request(self) -> PlanningRequest:
        query = WorldQuery(MODEL, self.bench.world)
        return scenes.planning_request(
            query, self.arm, scenes.scene_of(query, self.arm, Limits()), Limits(), SpeedLimits(), MARGIN_RAD
        )

    def _watch(self, tick: int) -> None:
        """Before each step: time passes, and touches and forces are noted."""
        self.bench.now_s += 0.001
        world = self.sim.world
        module = world.objects[self.module].id
        arm = next(body for body, name in world.names.items() if name == self.arm)
        total_n = 0.0
        for first, second in ((module, arm), (arm, module)):
            for contact in pybullet.getContactPoints(first, physicsClientId=world.client):
                other = contact[2]
                if other in (first, second) or contact[8] > 0.0 or contact[9] <= 0.0:
                    continue
                total_n += contact[9]
                name = world.names[other]
                if self._free or not (first == module and name.split()[0] == self._seat):
                    self._touches.add(f"{world.names[first]} and {name}")
        if self._free:
            wrench = self.subsystem.executors[self.arm].sample.wrench
            self._free_n = max(self._free_n, total_n)
            self._wrist_n = max(self._wrist_n, math.hypot(*wrench[:3]))

    def _judge(
        self, done: Done, carried: int, failures: list[str], refused: list[str], before: dict[str, Array]
    ) -> Run:
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
            refused=refused,
            succeeded=done.succeeded,
            seated=seated,
            off_m=off_m,
            off_rad=off_rad,
            free_n=self._free_n,
            wrist_n=self._wrist_n,
            peak_n=max((report.peak_force_n for report in done.reports), default=0.0),
            touches=touches,
            trims=len(done.trims),
            why=why.message if why else "",
            true=seated if done.succeeded else self.holds_still(),
        )


def cases(seed: int) -> Iterator[Case]:
    """Random ones; case `n` depends on the seed and `n` alone."""
    for n in itertools.count():
        random = np.random.default_rng((seed, n))
        arm = tuple(RACKS)[random.integers(len(RACKS))]
        places = ["", *(place.name for place in CELL.places if arm in place.poses)]
        yield Case(
            verb=tuple(SENTENCES)[random.integers(len(SENTENCES))],
            bay=bool(random.integers(2)),
            arm=arm,
            handle=HANDLES[random.integers(len(HANDLES))],
            grasp=int(random.integers(GRASPS)),
            vias=tuple(places[random.integers(len(places))] for _ in range(random.integers(1, MAX_VIAS + 1))),
            seed=seed * 100_000 + n,
        )


_hands: dict[tuple[str, str, int], Hand] = {}  # of a process


def run(case: Case) -> Run:
    key = case.arm, case.handle, case.grasp
    if key not in _hands:
        _hands[key] = Hand(*key)
    return _hands[key].run(case)


def _shared(asked: list[Case], processes: int) -> Iterator[Run]:
    """The runs in their order."""
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        yield from pool.imap(run, asked)


def main() -> None:
    words = numbered_runs.arguments(__doc__, runs=300)
    words.add_argument("--seed", type=int, default=SEED, help="of other runs, without results file")
    words.add_argument("--processes", type=int, default=1, help="share the runs; each has scenes of its own")
    words.add_argument("--first", type=int, default=0, help="number of the first run of a shard")
    words.add_argument("--part", type=Path, help="write the runs of a shard to this file, and no results file")
    words.add_argument("--join", type=Path, nargs="+", help="make no runs: the results of these shards")
    given = words.parse_args()
    if given.join:
        parts = [msgspec.json.decode(path.read_bytes(), type=dict[int, Run]) for path in given.join]
        joined = {n: one for part in parts for n, one in part.items()}
        question("from_anywhere", f"the runs of {len(parts)} shards", seed=given.seed)
        _report([joined[n] for n in sorted(joined)], kept=True)
        return
    question("from_anywhere", "do PLACE and INSERT seat a module from wherever the arm is?", seed=given.seed)
    wanted = [one for one in numbered_runs.chosen(given, cases(given.seed)) if one[0] >= given.first]
    if not wanted:
        words.error(f"--first {given.first}: --runs {given.runs} ends before it")
    found: dict[int, Run] = {}
    for (n, case), one in zip(wanted, _shared([case for _, case in wanted], given.processes), strict=True):
        found[n] = one
        print(f"  run {n}: {_words(case, one)}", flush=True)
        if given.part:
            given.part.write_bytes(msgspec.json.encode(found))
    whole = not given.only and not given.first and given.seed == SEED and not given.part
    _report(list(found.values()), kept=whole)


def _words(case: Case, one: Run) -> str:
    where = BAY if case.bay else RACKS[case.arm][1]
    end = "seated" if one.seated else f"NOT seated, off {1e3 * one.off_m:.1f} mm, {math.degrees(one.off_rad):.1f} deg"
    via = ", ".join(place or "a posture" for place in case.vias)
    return (
        f"{case.verb} {where} {case.arm} {case.handle} grasp {case.grasp} by {via}: {end};"
        f" on free ways {one.free_n:.1f} N, {one.wrist_n:.1f} N at the wrist; then {one.peak_n:.1f} N,"
        f" {one.trims} trims {one.carry_failures or ''} {one.refused or ''} {one.touches or ''} {one.why}"
        f"{'' if one.true else ' WRONG REPORT'} {one.after}"
    )


def _report(found: list[Run], *, kept: bool) -> None:
    good = [one for one in found if one.succeeded and one.seated and not one.touches]
    peaks, free, wrist = ([getattr(one, name) for one in found] for name in ("peak_n", "free_n", "wrist_n"))
    failures = [why for one in found for why in one.carry_failures]
    refused = [why for one in found for why in one.refused]
    worst_mm = 1e3 * max((one.off_m for one in found if one.seated), default=0.0)
    rows = [
        ("seated, reported so, nothing else touched", f"{len(good)} of {len(found)}"),
        ("at the first attempt", f"{sum(one.trims == 0 for one in good)}"),
        ("force on free ways, against other bodies", f"worst {max(free):.1f} N; above 5 N: {_above(free)}"),
        ("force on free ways, at the wrist", f"p50 {percentile(wrist, 50):.1f} N, worst {max(wrist):.1f} N"),
        ("peak of the wrist force", f"p50 {percentile(peaks, 50):.0f} N, worst {max(peaks):.0f} N"),
        ("distance from the seated place", f"worst {worst_mm:.1f} mm"),
        ("true reports", f"{sum(one.true for one in found)} of {len(found)}"),
        ("carries that ended on the way; refused ones", f"{len(failures)}; {len(refused)}"),
    ]
    metrics: dict[str, float | None] = {
        "runs": float(len(found)),
        "seated": float(len(good)),
        "free_n": max(free),
        "above_5_n": float(_above(free)),
        "free_wrist_n": max(wrist),
        "true": float(sum(one.true for one in found)),
        "peak_n_p50": percentile(peaks, 50),
        "peak_n": max(peaks),
        "off_mm": worst_mm,
        "carries_failed": float(len(failures)),
        "carries_refused": float(len(refused)),
    }
    numbered_runs.report("from_anywhere", metrics, rows, kept=kept)


def _above(forces: list[float]) -> int:
    return sum(n > MAX_N for n in forces)


if __name__ == "__main__":
    main()
