"""How often and how fast is a motion to a free goal found, among racks, bay, modules and the other arm?

    python -m benchmarks.planning                              # 1,000 goals per arm, some 20 minutes
    python -m benchmarks.planning --cell panda                 # seven joints, without a closed form
    python -m benchmarks.planning --goals 100 --peers 20       # a short run

Goals are random free poses of each arm, half of them near a seat, half of them with a module in the hand. Each query
starts at the goal before, or where a halt left the arm. Times are processor time of one process, so that other
processes do not count; wall time is stated beside them. Each path found is tested again with a step of a third.

Peers get evenly drawn queries of the same run. They are the direct ways alone (lines and detours, without sampling),
and OMPL's RRT-Connect with pybullet as its collision checker (`pip install -e ".[bench]"`; left out if missing). What
can be reached is what our planner finds, or OMPL over our own checks finds in 5 s.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.load.planning_queries import Queries, Query
from benchmarks.peers import attitude_flood, direct_ways
from benchmarks.report import finish, percentile, question, spread
from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import Refused
from rtc.runtime import process
from rtc.spatial.geometry import Array
from workers.elaborator.backtrack import MAX_DETOURED
from workers.planning.motion.path import CHECK_RAD, Path
from workers.planning.motion.plan import find_joint_way, in_time
from workers.planning.motion.request import FreeWay, fault
from workers.planning.robot_models import CellModel

SEED = 22
LIMIT_S = 5.0  # of a search by OMPL


@dataclass
class Tally:
    """The results of one planner, in the order of its queries."""

    cpu_s: list[float] = field(default_factory=list)
    wall_s: list[float] = field(default_factory=list)
    found: list[bool] = field(default_factory=list)
    length: list[float] = field(default_factory=list)  # of the paths found, times the straight line in joint space

    def run(self, query: Query, planner: Callable[[Query], Any]) -> Any:
        """What the planner found, or None."""
        cpu_s, wall_s = time.process_time(), time.perf_counter()
        path = planner(query)
        self.cpu_s.append(time.process_time() - cpu_s)
        self.wall_s.append(time.perf_counter() - wall_s)
        self.found.append(path is not None)
        if path is not None:
            self.length.append(_length(path) / max(float(np.linalg.norm(query.goal - query.request.start)), 1e-9))
        return path

    def rows(self, name: str) -> Iterable[tuple[str, str]]:
        yield f"{name}: found", f"{sum(self.found)} of {len(self.found)}"
        yield f"{name}: processor time", spread(self.cpu_s, 1e3, "ms")
        yield f"{name}: wall time", spread(self.wall_s, 1e3, "ms")
        yield f"{name}: length, times the line in joint space", spread(self.length, 1.0, "")


@dataclass
class Figures:
    """All results."""

    ours: Tally = field(default_factory=Tally)
    direct: Tally = field(default_factory=Tally)
    bullet: Tally = field(default_factory=Tally)
    drawn: list[int] = field(default_factory=list)  # numbers of the queries that the peers got
    direct_line: list[bool] = field(default_factory=list)  # by query: our path is a line in joint space
    duration_s: list[float] = field(default_factory=list)
    timing_s: list[float] = field(default_factory=list)
    not_free: int = 0
    missed: int = 0  # found in 5 s only
    unknown: int = 0  # refused, and no reference searched
    level: Tally = field(default_factory=Tally)
    level_without: int = 0  # goals that are not found, and that `attitude_flood` shows to have no way


def main() -> None:
    words = argparse.ArgumentParser(
        prog="python -m benchmarks.planning", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    words.add_argument("--cell", default="swapout", help="with its first attitude")
    words.add_argument("--goals", type=int, default=1000, help="per arm")
    words.add_argument("--peers", type=int, default=100, help="of them, per arm, for the peers")
    words.add_argument(
        "--level", type=int, default=100, help="further goals per arm, with the first attitude of the cell kept"
    )
    given = words.parse_args()
    name = "planning" if given.cell == "swapout" else f"planning_{given.cell}"
    question(name, "How often and how fast is a motion to a free goal found?", seed=SEED)
    model, figures = CellModel(Cell.load(given.cell)), Figures()
    attitude = next(iter(model.cell.attitudes))
    process.freeze_heap()  # as the workers do
    ompl = _ompl()
    bullet = ompl.BulletCell(model) if ompl is not None else None
    for arm in model.arms:
        every = max(1, given.goals // max(1, given.peers))
        for n, query in enumerate(Queries(model, arm, SEED).take(given.goals)):
            _ours(figures, query, ompl)
            if n % every == 0 and given.peers:
                figures.drawn.append(len(figures.ours.found) - 1)
                figures.direct.run(query, lambda q: direct_ways.find(q.request, q.goal))
                if bullet is not None:
                    free = bullet.test(query.request)
                    figures.bullet.run(query, lambda q, free=free: ompl.plan(q.request, q.goal, free, LIMIT_S))
            if (n + 1) % 100 == 0:
                print(f"  {arm}: {n + 1} of {given.goals} goals", flush=True)
        for query in Queries(model, arm, SEED, attitude).take(given.level):
            if figures.level.run(query, _to_any) is None and given.cell == "swapout":
                figures.level_without += not attitude_flood.has_way(query.request, query.goals)
    finish(name, _metrics(figures), list(_rows(figures, attitude)))


def _ompl() -> Any:
    try:
        from benchmarks.peers import ompl_bullet
    except ImportError as error:
        print(f"  without OMPL: {error}", flush=True)
        return None
    return ompl_bullet


def _ours(figures: Figures, query: Query, ompl: Any) -> None:
    path = figures.ours.run(query, _to_goal)
    figures.direct_line.append(path is not None and path.curve is None)
    if path is None:
        if ompl is None:
            figures.unknown += 1
        elif ompl.plan(query.request, query.goal, ompl.reference(query.request), LIMIT_S) is not None:
            figures.missed += 1
        return
    figures.not_free += fault(query.request, path, CHECK_RAD / 3) is not None
    began_s = time.process_time()
    motion = in_time(query.request, FreeWay(path, []))
    figures.timing_s.append(time.process_time() - began_s)
    figures.duration_s.append(motion.timed.duration_s)


def _to_goal(query: Query) -> Path | None:
    try:
        return find_joint_way(query.request, query.goal).path
    except Refused:
        return None


def _to_any(query: Query) -> Path | None:
    """To the first postures of the goal, as the elaborator tries them."""
    paths = (_to_goal(replace(query, goals=[goal])) for goal in query.goals[:MAX_DETOURED])
    return next((path for path in paths if path is not None), None)


def _length(path: Path | list[Array]) -> float:
    rows = path.dense(0.1)[1] if isinstance(path, Path) else np.array(path)
    return float(np.linalg.norm(np.diff(rows, axis=0), axis=1).sum())


def _ratio(theirs: Tally, figures: Figures) -> float | None:
    """How many times the processor time of ours the peer takes, in the median of the same queries."""
    if not theirs.cpu_s:
        return None
    return percentile(theirs.cpu_s, 50) / percentile([figures.ours.cpu_s[n] for n in figures.drawn], 50)


def _metrics(figures: Figures) -> dict[str, float | None]:
    ours, found = figures.ours, sum(figures.ours.found)
    reachable = found + figures.missed
    return {
        "goals": float(len(ours.found)),
        "success_percent": 100.0 * found / len(ours.found),
        "of_reachable_percent": None if figures.unknown else 100.0 * found / reachable,
        "cpu_p50_ms": 1e3 * percentile(ours.cpu_s, 50),
        "cpu_p99_ms": 1e3 * percentile(ours.cpu_s, 99),
        "wall_p50_ms": 1e3 * percentile(ours.wall_s, 50),
        "wall_p99_ms": 1e3 * percentile(ours.wall_s, 99),
        "not_free_at_a_finer_step": float(figures.not_free),
        "direct_success_percent": 100.0 * float(np.mean(figures.direct.found)) if figures.direct.found else None,
        "bullet_success_percent": 100.0 * float(np.mean(figures.bullet.found)) if figures.bullet.found else None,
        "vs_ompl_pybullet": _ratio(figures.bullet, figures),
        "level_success_percent": 100.0 * float(np.mean(figures.level.found)) if figures.level.found else None,
        "level_without_a_way": float(figures.level_without),
        "level_cpu_p50_ms": 1e3 * percentile(figures.level.cpu_s, 50) if figures.level.found else None,
    }


def _rows(figures: Figures, attitude: str) -> Iterable[tuple[str, str]]:
    ours = figures.ours
    yield from ours.rows("ours")
    around = [t for t, line in zip(ours.cpu_s, figures.direct_line, strict=True) if not line]
    yield "ours: lines in joint space", f"{sum(figures.direct_line)}"
    if around:
        yield "ours: processor time of all others", spread(around, 1e3, "ms")
    yield "ours: refused, but found in 5 s", "not searched" if figures.unknown else str(figures.missed)
    yield "ours: not free at a finer step", str(figures.not_free)
    yield "ours: timing after that, processor time", spread(figures.timing_s, 1e3, "ms")
    yield "ours: duration of the motion", spread(figures.duration_s)
    if figures.drawn:
        same = Tally(*([column[n] for n in figures.drawn] for column in (ours.cpu_s, ours.wall_s, ours.found)))
        yield "ours, on the queries of the peers: found", f"{sum(same.found)} of {len(same.found)}"
        yield "ours, on the queries of the peers: processor time", spread(same.cpu_s, 1e3, "ms")
        yield from figures.direct.rows("direct ways alone")
    if figures.bullet.found:
        yield from figures.bullet.rows("OMPL RRT-Connect with pybullet")
    if figures.level.found:
        yield from figures.level.rows(f"ours, {attitude} kept")
        yield f"{attitude} kept: without a way", str(figures.level_without)


if __name__ == "__main__":
    main()
