"""Is any path that the planner accepts refused by coal alone at a third of its step?

Random goals of both arms (`benchmarks.load.planning_queries`): empty hand and laden, near a seat and anywhere; with
`--level` of each hundred the attitude is kept. Every tenth plan has a second one: the other arm moves at the same time.
The planner proves its paths with the compiled boxes first. The judge has none: pinocchio and coal check each posture
themselves, in a collision world of their own. Of two motions, random pairs of postures are checked, those that the
later motion's start condition excludes left out.

    python -m tests.campaigns.random_plans [--runs 10000] [--level 10] [--cell servicing]
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator

import msgspec
import numpy as np
from msgspec.structs import replace

from benchmarks.load.planning_queries import Queries, Query
from benchmarks.report import finish, question
from rtc.model.cells.cell import Cell
from rtc.model.robot.collision import CollisionWorld
from rtc.protocol.outcomes import Refused, StopReason
from rtc.protocol.primitive import GoalReached, Primitive, StartAfter, StopFunction, TimeAbove
from rtc.spatial.geometry import Array
from tests.campaigns import RESULTS
from workers.planning.motion import beside
from workers.planning.motion.path import CHECK_RAD
from workers.planning.motion.plan import Motion, plan_joint_motion
from workers.planning.motion.request import PlanningRequest, fault
from workers.planning.robot_models import CellModel

SEED = 71
PAIR_EVERY = 10  # plans
PAIRS = 60  # of postures of two motions
TRIES = 30  # goals of the second arm
STOPS = [
    StopFunction(reason=StopReason.GOAL, when=GoalReached()),
    StopFunction(reason=StopReason.TIMEOUT, when=TimeAbove(600.0)),
]


class Judge:
    """Plans random motions of a cell and judges each by coal alone."""

    def __init__(self, cell: Cell) -> None:
        self._model = CellModel(cell)
        self._coal = CollisionWorld(cell, boxes=False)
        self._rng = np.random.default_rng(SEED)
        self.counts: Counter[str] = Counter()

    def run(self, query: Query) -> None:
        """Plan one motion, and judge it."""
        try:
            motion = plan_joint_motion(query.request, query.goal)
        except Refused:
            self.counts["refused"] += 1
            return
        self.counts["plans"] += 1
        self.counts["not free"] += self.is_hit(query.request, motion)
        if self.counts["plans"] % PAIR_EVERY == 0 and len(self._model.arms) > 1:
            self._second(query, motion)

    def is_hit(self, request: PlanningRequest, motion: Motion) -> bool:
        return fault(replace(request, world=self._coal), motion.path, CHECK_RAD / 3) is not None

    def _second(self, query: Query, first: Motion) -> None:
        """Plan a motion of another arm beside this one; it sees this arm at its goal, as in the binder."""
        name = query.request.arm.name
        arm = next(one for one in self._model.arms.values() if one.name != name)
        joints = {**query.request.joints, name: query.goal}
        scene = replace(query.request.scene, moving=arm.name)
        request = replace(query.request, arm=arm, joints=joints, scene=scene, load=None)
        found = self._any_motion(request)
        if found is None:
            self.counts["no second motion"] += 1
            return
        mine, theirs = self._primitive(request, found, "C-2.1"), self._primitive(query.request, first, "C-1.1")
        try:
            conditions = beside.start_conditions(request, mine, [theirs], follows=True)
        except Refused:
            self.counts["pairs refused"] += 1
            return
        self.counts["pairs"] += 1
        self.counts["pairs that wait"] += bool(conditions)
        self.counts["pairs that may wait on their way"] += any(condition.further for condition in conditions)
        self.counts["pairs that meet"] += any(
            self._coal.check({**joints, arm.name: one, name: other}, replace(scene, clearance_m=0.0)) is not None
            for one, other in self._posture_pairs(found, first, conditions[0] if conditions else None)
        )

    def _posture_pairs(
        self, mine: Motion, theirs: Motion, condition: StartAfter | None
    ) -> Iterator[tuple[Array, Array]]:
        """Any posture of one motion with any that the other still has before it when the first is there."""
        for my_s in self._rng.uniform(0.0, mine.timed.duration_s, PAIRS).tolist():
            from_s = min(condition.needed_s(my_s) if condition else 0.0, theirs.timed.duration_s)
            their_s = self._rng.uniform(from_s, theirs.timed.duration_s)
            yield mine.timed.at(np.array([my_s]))[0, 0], theirs.timed.at(np.array([their_s]))[0, 0]

    def _any_motion(self, request: PlanningRequest) -> Motion | None:
        limits = request.arm.limits
        for _ in range(TRIES):
            try:
                return plan_joint_motion(request, self._rng.uniform(limits.lower, limits.upper))
            except Refused:
                continue
        return None

    def _primitive(self, request: PlanningRequest, motion: Motion, name: str) -> Primitive:
        arm = request.arm.name
        made = Primitive(id=name, performer=arm, trajectory=motion.timed.trajectory(), stop_functions=STOPS)
        return msgspec.structs.replace(made, space_mm=beside.space_of(request, made))


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--runs", type=int, default=10_000)
    words.add_argument("--level", type=int, default=10, help="of each hundred, with the first attitude of the cell")
    words.add_argument("--cell", default="swapout")
    given = words.parse_args()
    question("random_plans", "is any accepted path refused by coal alone at a third of the step?", seed=SEED)
    judge = judged(Cell.load(given.cell), given.runs, given.level)
    metrics = {name.replace(" ", "_"): float(count) for name, count in judge.counts.items()}
    name = "random_plans" if given.cell == "swapout" else f"random_plans_{given.cell}"
    finish(name, metrics, [(name, str(count)) for name, count in judge.counts.items()], RESULTS)
    if judge.counts["not free"] or judge.counts["pairs that meet"]:
        raise SystemExit(1)


def judged(cell: Cell, runs: int, level: int) -> Judge:
    judge, model = Judge(cell), CellModel(cell)
    attitude = next(iter(cell.attitudes), "")
    for arm in model.arms:
        share = runs // len(model.arms)
        kept = share * level // 100 if attitude else 0
        for kind, count in (("", share - kept), (attitude, kept)):
            for n, query in enumerate(Queries(model, arm, SEED, kind).take(count) if count else (), 1):
                judge.run(query)
                if n % 500 == 0:
                    print(f"  {arm} {kind}: {n} of {count}: {dict(judge.counts)}", flush=True)
    return judge


if __name__ == "__main__":
    main()
