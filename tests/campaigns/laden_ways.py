"""Does an arm with a module in its hand keep its distance from everything, on every way?

Ways of both arms, with both handles, between all seats and places, drawn at random: the start in any free posture at a
place or before a seat, the other arm at rest at home, stowed or at a place. Each way is planned as a sentence (MOVE,
STOW, PLACE or INSERT) by elaborator and binder. No physics: the arm is taken to follow its trajectory.

`tests.campaigns.clearances` judges every trajectory with distances of its own, at a third of the planner's step. The
least distance of arm, hand and module from every other body, and of the module from its own arm, must be 5 mm and the
spread of what is believed. Only the straight lines of PLACE and INSERT may touch the seat.

    python -m tests.campaigns.laden_ways [--runs 2000] [--processes 2]
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
from collections import Counter
from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from benchmarks.report import percentile, question
from rtc.protocol.messages import BoundStep, EndReport
from rtc.protocol.primitive import JointTrajectory, Primitive
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from tests.campaigns import advice, numbered_runs
from tests.campaigns.advice import Answer
from tests.campaigns.clearances import FAR_M, Clearances, Least, Placed
from tests.workers.conftest import CELL, MODEL, Bench, Reporter
from workers.planning.world_query import WorldQuery

SEED = 31
KEPT_M = 0.005
ROUNDING_M = 1e-5
MARGIN_RAD = 0.06  # of starts from every joint limit
RACKS = {"RIGHT-ARM": ("MACS-NEW", "RACK-1"), "LEFT-ARM": ("MACS-OLD", "RACK-2")}
HANDLES = ("HANDLE-A", "HANDLE-B")
SEATS = tuple(seat.name for seat in CELL.seats)
BEFORE_M = 0.08  # a start before a seat, beyond its depth
TRIES = 200  # starts drawn for one way


class Case(NamedTuple):
    arm: str
    handle: str
    start: str  # a seat, a place, or HOME
    goal: str  # a seat, a place, or STOW
    verb: str  # to a seat
    seed: int


class Judged(NamedTuple):
    """The least distance of one motion from what it does not mean to touch."""

    straight: bool
    least: Least


class Way(NamedTuple):
    sentence: str
    refusal: str  # before any motion
    motions: list[Judged]
    end: str = ""  # what the advice of the refusal led to
    story: list[str] = []  # noqa: RUF012


class Judge(Reporter):
    """Reports perfect motions, and judges each."""

    def __init__(self) -> None:
        super().__init__(CELL)
        self.judged: list[Judged] = []
        self.bench: Bench

    def perform(self, made: Primitive, bound: BoundStep) -> EndReport:
        if isinstance(made.trajectory, JointTrajectory):
            self.judged.append(self._judge(made, bound))
        return super().perform(made, bound)

    def _judge(self, made: Primitive, bound: BoundStep) -> Judged:
        assert bound.evaluation is not None
        query, context = WorldQuery(MODEL, self.bench.world), bound.evaluation.context
        arm, held = made.performer, bound.evaluation.held
        straight = bound.evaluation.step.space != "move_joint"
        may_touch: set[frozenset[str]] = set()
        if straight:
            touched = {context.object, context.target, query.seat(context.object) if context.object else ""} - {""}
            may_touch = {frozenset((one, other)) for one in (arm, held) for other in touched if one and one != other}
        in_hand = {name: query.grasp(name) for name in (held,) if name}
        placed = Placed(
            arm=arm,
            joints={name: query.joints(name) for name in MODEL.arms},
            openings_m={name: query.hand_width(name) for name in MODEL.arms},
            poses={thing.name: query.frame(thing.name) for thing in CELL.objects},
            held={name: (arm, pose) for name, pose in in_hand.items() if pose is not None},
        )
        assert isinstance(made.trajectory, JointTrajectory)
        return Judged(straight, _clearances().least(placed, made.trajectory, may_touch))


@cache
def _clearances() -> Clearances:
    return Clearances(CELL)


@cache
def _held(arm: str, handle: str) -> Bench:
    """After the lift out of the rack."""
    module, _ = RACKS[arm]
    judge = Judge()
    bench = judge.bench = Bench(judge)
    for sentence in (f"GRASP {module} {handle} WITH {arm}", f"LIFT {module} BY 15 CM"):
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal)
    return bench


def run(case: Case) -> Way:
    bench = _held(case.arm, case.handle)
    judge, world = bench.subsystem, bench.world
    joints, widths, poses = dict(judge.joints), dict(judge.widths), dict(judge.poses)
    try:
        _set_out(bench, case, np.random.default_rng(case.seed))
        judge.judged = []
        module, _ = RACKS[case.arm]
        sentence = f"MOVE {case.arm} TO {case.goal}"
        if case.goal == "STOW":
            sentence = f"STOW {case.arm}"
        elif case.goal in SEATS:
            sentence = f"{case.verb} {module} {'ON' if case.verb == 'PLACE' else 'INTO'} {case.goal} WITH {case.arm}"
        done = bench.do(sentence)
        if not done.refusal or judge.judged:
            return Way(sentence, "", judge.judged)

        def truth() -> dict[str, Any]:
            return {"poses": judge.poses, "seats": {seat.name: seat.frame.pose for seat in CELL.seats}}

        followed = advice.follow(lambda text: Answer.of(bench.do(text)), sentence, Answer.of(done), truth)
        return Way(sentence, done.refusal.message, judge.judged, followed.end, followed.history)
    finally:
        bench.world, judge.joints, judge.widths, judge.poses = world, joints, widths, poses


def _set_out(bench: Bench, case: Case, random: np.random.Generator) -> None:
    """The other arm to one of its resting places, and this one to a start that keeps the distance."""
    other = next(name for name in MODEL.arms if name != case.arm)
    for _ in range(TRIES):
        rest = _rest(other, random)
        start = _start(bench, case, random)
        if rest is None or start is None:
            continue
        stay = JointTrajectory(
            space="joint",
            time_s=[0.0, 1.0],
            positions=[start.tolist()] * 2,
            velocities=[[0.0] * len(start)] * 2,
            accelerations=[[0.0] * len(start)] * 2,
        )
        query, module = WorldQuery(MODEL, bench.world), RACKS[case.arm][0]
        grasp = query.grasp(module)
        assert grasp is not None
        placed = Placed(
            arm=case.arm,
            joints={case.arm: start, other: rest},
            openings_m={name: query.hand_width(name) for name in MODEL.arms},
            poses={thing.name: query.frame(thing.name) for thing in CELL.objects},
            held={module: (case.arm, grasp)},
        )
        if _clearances().least(placed, stay, set()).distance_m >= 2 * KEPT_M:
            for name, q in ((case.arm, start), (other, rest)):
                bench.set_fact(f"{name}.joints", q.tolist())
                bench.subsystem.joints[name] = q.copy()
            frame = geometry.compose(MODEL.arms[case.arm].fk(start), grasp)
            bench.set_fact(f"{module}.frame", frame.tolist())
            bench.subsystem.poses[module] = frame
            return
    raise AssertionError(f"no start for {case}")


def _rest(arm: str, random: np.random.Generator) -> Array | None:
    spec = CELL.arm(arm)
    poses = [place.poses[arm].pose for place in CELL.places if arm in place.poses]
    n = int(random.integers(len(poses) + 2))
    if n < 2:
        return np.array((spec.home_rad, spec.stow_rad)[n])
    found = MODEL.arms[arm].ik(poses[n - 2], spec.home_rad, MARGIN_RAD)
    return found[0] if found else None


def _start(bench: Bench, case: Case, random: np.random.Generator) -> Array | None:
    """A posture at the start, or, if the arm cannot be there with the module, anywhere."""
    model = MODEL.arms[case.arm]
    pose = _start_pose(bench, case)
    found = model.ik(pose, CELL.arm(case.arm).home_rad, MARGIN_RAD) if pose is not None else []
    if found and random.random() < 0.9:
        return found[int(random.integers(len(found)))]
    limits = model.limits
    return random.uniform(limits.lower + MARGIN_RAD, limits.upper - MARGIN_RAD)


def _start_pose(bench: Bench, case: Case) -> Array | None:
    if case.start in SEATS:
        seat = CELL.seat(case.start)
        grasp = WorldQuery(MODEL, bench.world).grasp(RACKS[case.arm][0])
        assert grasp is not None
        out = geometry.rotate(seat.frame.pose, seat.way_out)
        before = geometry.translate(CELL.seated_pose(case.start), (seat.depth_m + BEFORE_M) * out)
        return geometry.compose(before, geometry.inverse(grasp))
    place = next((place for place in CELL.places if place.name == case.start), None)
    return None if place is None or case.arm not in place.poses else np.array(place.poses[case.arm].pose)


def cases(seed: int) -> Iterator[Case]:
    """All pairs of starts and goals of both arms and handles in turn, each time with other postures."""
    for n in itertools.count():
        for m, (arm, handle) in enumerate(itertools.product(RACKS, HANDLES)):
            places = [p.name for p in CELL.places if arm in p.poses]
            here, there = [*SEATS, *places, "HOME"], [*SEATS, *places, "STOW"]
            for k, (start, goal) in enumerate(itertools.product(here, there)):
                if start != goal:
                    yield Case(arm, handle, start, goal, ("PLACE", "INSERT")[n % 2], [seed, n, m, k])  # type: ignore[arg-type]


def shuffled(seed: int) -> Iterator[Case]:
    """The cases in an order in which any first few cover all arms, handles and goals."""
    drawn = cases(seed)
    while True:
        some = list(itertools.islice(drawn, 200))
        yield from (some[n] for n in np.random.default_rng(seed).permutation(len(some)).tolist())


def too_near(way: Way) -> list[Judged]:
    """The motions that did not keep the distance."""
    return [one for one in way.motions if one.least.distance_m < KEPT_M - ROUNDING_M]


def main() -> None:
    words = numbered_runs.arguments(__doc__, runs=2000)
    words.add_argument("--seed", type=int, default=SEED, help="of other ways, without results file")
    words.add_argument("--processes", type=int, default=1)
    given = words.parse_args()
    question("laden_ways", "does a held module keep its distance on every way?", seed=given.seed)
    wanted = list(numbered_runs.chosen(given, shuffled(given.seed)))
    ways: list[Way] = []
    with multiprocessing.get_context("spawn").Pool(given.processes) as pool:
        found = pool.imap(run, [case for _, case in wanted], chunksize=8)
        for (n, case), way in zip(wanted, found, strict=True):
            ways.append(way)
            for one in too_near(way):
                print(f"  way {n}: {way.sentence} from {case.start}: {one}", flush=True)
            if given.only or way.end == "same advice":
                print(n, case, way.end, *way.story, sep="\n    ")
    _report(ways, given)


def _report(ways: list[Way], given: argparse.Namespace) -> None:
    free = [one.least.distance_m for way in ways for one in way.motions if not one.straight]
    straight = [one.least.distance_m for way in ways for one in way.motions if one.straight]
    refused = [way for way in ways if way.refusal]
    bad = [way for way in ways if too_near(way)]
    kinds = Counter(_kind(way.refusal) for way in refused)
    ends = Counter(way.end for way in refused)
    least_mm = 1e3 * min((*free, *straight))
    rows = [
        ("ways", f"{len(ways)}; refused before any motion: {len(refused)}"),
        ("ways nearer than 5 mm", str(len(bad))),
        ("least distance on free ways", f"{1e3 * min(free):.2f} mm, p10 {1e3 * percentile(free, 10):.1f} mm"),
        ("least distance on lines, from what they do not touch", f"{1e3 * min(straight, default=FAR_M):.2f} mm"),
        ("advice of refusals", "; ".join(f"{n} {end}" for end, n in ends.most_common())),
        (
            "refusals",
            "; ".join(f"{n} {why}" for why, n in kinds.most_common(6)),
        ),
    ]
    metrics: dict[str, float | None] = {
        "ways": float(len(ways)),
        "planned": float(len(ways) - len(refused)),
        "too_near": float(len(bad)),
        "same_advice": float(ends["same advice"]),
        "least_mm": least_mm,
        "free_p10_mm": 1e3 * percentile(free, 10),
    }
    numbered_runs.report("laden_ways", metrics, rows, kept=not given.only and given.seed == SEED)


def _kind(why: str) -> str:
    """A refusal without its figures."""
    return " ".join(word for word in why.split("(")[0].split(";")[0].split() if not any(c.isdigit() for c in word))[:90]


if __name__ == "__main__":
    main()
