"""Does an arm that the operator moves keep its distance from what is near, in physics?

Of each run are drawn: whether the hand holds a module, a posture near bodies, and a stick towards the nearest of them,
or anywhere, with turns. The same stick is held through two grants: from this posture, and from where the first one has
led. F is that of GIVE, from the binder. Distances and contacts are those of the physics library, of arm, hand and load
with all else, and of the load with the links behind the hand.

    python -m tests.campaigns.operator_near [--runs 200] [--only 17]
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pybullet

from benchmarks.report import question
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.spatial import geometry
from rtc.subsystems.motion.arm import TICK_S
from rtc.subsystems.motion.executor import Executor
from sim_mcm.period import period
from tests.campaigns import numbered_runs
from tests.campaigns.held_module import HeldModule

SEED = 40
ARM, MODULE = "RIGHT-ARM", "MACS-NEW"
EMPTY = ("MOVE RIGHT-ARM BY 3 CM ALONG UP",)
LADEN = ("GRASP MACS-NEW HANDLE-A WITH RIGHT-ARM", "LIFT MACS-NEW BY 25 CM WITH RIGHT-ARM")
GRANTS_S = (3.0, 1.0)
PERIOD = 20  # ticks between two messages
FAR_M, FREE_M = 0.12, 0.007  # of the nearest body at the start
LIMIT_M = 0.005  # declared
HELD_N = 3.0  # of a contact that is a touch


class Grant(NamedTuple):
    least_m: float  # of all its ticks
    pair: str
    touched_n: float  # the greatest normal force
    end: str  # reason of the stop that ended it; empty: the deadman was let go
    way_m: float  # how far the tcp has come


class NearBench:
    """The cell in which one arm is at a drawn place; `held`: what its hand holds."""

    def __init__(self, laden: bool) -> None:
        self.held = HeldModule(ARM, MODULE, LADEN if laden else EMPTY)
        self.sim = self.held.sim
        self.arm, self.world = self.sim.arms[ARM], self.sim.world
        self._opening_m = (
            0.0 if laden else self.arm.traits.max_opening_m
        )  # where the spring of the grip is stretched to
        self.load = {self.world.objects[MODULE].id} if laden else set()
        script = self.held.bench.elaborate("GIVE RIGHT-ARM TO OPERATOR")
        bound = self.held.bench.bind(script, script.steps[-1])
        self.grant: p.Primitive = bound.primitive

    def distances(self, within_m: float) -> Iterator[tuple[float, str, Any]]:
        """All pairs nearer than this."""
        mine = {self.arm.body, *self.load}
        links = self.arm._moved_by
        for body in mine:
            for other in self.world.names:
                own = other == self.arm.body and body in self.load
                if other in mine and not own:
                    continue
                for point in pybullet.getClosestPoints(body, other, within_m, physicsClientId=self.world.client):
                    if (
                        links[point[4]] == len(self.held.joints)
                        if own
                        else body == self.arm.body and not links[point[3]]
                    ):
                        continue
                    yield point[8], f"{self.world.names[body]} {self.world.names[other]}", point

    def touched_n(self) -> float:
        mine = {self.arm.body, *self.load}
        points = [n for body in mine for n in pybullet.getContactPoints(body, physicsClientId=self.world.client)]
        return max((n[9] for n in points if n[2] not in mine), default=0.0)

    def begin(self, rng: np.random.Generator) -> Any:
        """Bring the arm to a drawn posture near a body; returns the pair that is nearest."""
        limits = self.arm.traits
        while True:
            self.held.restore()
            self.arm._hand.wanted_m = self._opening_m
            joints = np.array(self.held.joints) + rng.uniform(-0.9, 0.9, len(self.held.joints))
            if (joints < np.array(limits.lower) + 0.1).any() or (joints > np.array(limits.upper) - 0.1).any():
                continue
            before = self.arm.tcp_pose(self.held.joints)
            hand = self.arm.tcp_pose(joints.tolist())
            for index, value in zip(self.arm._arm, joints, strict=True):
                pybullet.resetJointState(self.arm.body, index, value, 0.0, physicsClientId=self.world.client)
            for name in [MODULE] if self.load else []:
                grasp = geometry.relative(before, self.world.pose(name))
                self.world.place(self.world.objects[name], geometry.compose(hand, grasp))
            found = min(self.distances(FAR_M), default=None, key=lambda one: one[0])
            if found is not None and found[0] > FREE_M:
                still = [0.0] * len(joints)
                self.arm.read()
                self.arm.follow((joints.tolist(), still, still))
                for _ in range(150):
                    self.arm.read()
                    self.sim.step()
                found = min(self.distances(FAR_M), default=None, key=lambda one: one[0])
                if found is not None and found[0] > FREE_M:
                    return found

    def run(self, rng: np.random.Generator) -> list[Grant]:
        nearest = self.begin(rng)
        towards = -np.array(nearest[2][7]) + (rng.normal(size=3) * float(rng.choice([0.0, 0.3, 3.0])))
        linear = float(rng.choice([0.02, 0.1, 1.0])) * towards / np.linalg.norm(towards)
        angular = float(rng.choice([0.0, 0.1, 0.5])) * rng.normal(size=3)
        executor = Executor(self.arm)
        executor._hand.command = self.held._hand
        return [self._hold(executor, n, [*linear, *angular], seconds) for n, seconds in enumerate(GRANTS_S)]

    def _hold(self, executor: Executor, number: int, twist: list[float], seconds: float) -> Grant:
        """Hold the stick through one grant."""
        primitive = msgspec.structs.replace(self.grant, id=f"C-7.{number + 1}")
        now_s, end, least, touched_n = 100.0 * (number + 1), "", (math.inf, ""), 0.0
        started = executor.accept(primitive, now_s)
        assert isinstance(started[0], m.Started), started
        start = self.arm.tcp_pose(executor.sample.joints)[:3]
        for tick in range(round(seconds / TICK_S) + 400):
            now_s += TICK_S
            if executor.operated is not None and tick % PERIOD == 0:
                holds = tick < seconds / TICK_S
                wanted = m.Operate(primitive=primitive.id, operator="ADA", seen_at_s=now_s, hold=holds, twist=twist)
                executor.operate(wanted, b"ada", now_s)
            for report in period(executor.tick, self.sim, now_s):
                end = report.reason.value if isinstance(report, m.EndReport) else end
            touched_n = max(touched_n, self.touched_n()) if self.world.in_contact else touched_n
            if tick % 10 == 0:
                found = min(((away, pair) for away, pair, _ in self.distances(FAR_M)), default=(math.inf, ""))
                least = min(least, found)
            if executor.primitive is None and end:
                break
        way_m = math.dist(start, self.arm.tcp_pose(executor.sample.joints)[:3])
        if executor.primitive is not None:
            executor.answer(m.OperatorAnswer(primitive=primitive.id, done=False, why="enough"))
            while executor.primitive is not None:
                now_s += TICK_S
                period(executor.tick, self.sim, now_s)
        return Grant(*least, touched_n, end, way_m)


@cache
def near_bench(laden: bool) -> NearBench:
    return NearBench(laden)


def one_run(number: int) -> list[Grant]:
    """The two grants of the run of this number; odd ones have a load."""
    return near_bench(number % 2 == 1).run(np.random.default_rng([SEED, number]))


def wrong(grants: list[Grant]) -> list[str]:
    found = []
    for n, grant in enumerate(grants):
        if grant.touched_n > 0.0:
            found.append(f"grant {n + 1}: touched with {grant.touched_n:.1f} N: {grant.pair}")
        elif grant.least_m < LIMIT_M:
            found.append(f"grant {n + 1}: {1e3 * grant.least_m:.2f} mm: {grant.pair}")
    return found


def main() -> None:
    given = numbered_runs.arguments(__doc__, runs=200).parse_args()
    question("operator_near", "Does an arm that the operator moves keep its distance, in physics?", seed=SEED)
    runs: list[list[Grant]] = []
    failed = 0
    for number, _ in numbered_runs.chosen(given, iter(range(1 << 30))):
        runs.append(grants := one_run(number))
        words = wrong(grants)
        failed += bool(words)
        if words or given.only:
            print(f"run {number}: {words} {grants}", flush=True)
    metrics: dict[str, float | None] = {"runs": len(runs), "violations": failed}
    rows = [("runs", str(len(runs))), ("with a violation", str(failed))]
    for n, name in enumerate(("first", "second")):
        least = sorted(1e3 * grants[n].least_m for grants in runs if math.isfinite(grants[n].least_m))
        cuts = [least[min(len(least) - 1, round(share * (len(least) - 1)))] for share in (0.0, 0.1, 0.5, 0.9)]
        ends = sum(bool(grants[n].end) for grants in runs)
        metrics |= {f"{name}_least_mm": cuts[0], f"{name}_median_mm": cuts[2], f"{name}_stopped": ends}
        shown = ", ".join(f"{cut:.2f}" for cut in cuts)
        rows.append((f"{name} grant: least distance, 10 %, 50 %, 90 % (mm); stopped", f"{shown}; {ends}"))
    numbered_runs.report("operator_near", metrics, rows, kept=not given.only)


if __name__ == "__main__":
    main()
