"""Does a grasp find a module that is up to 25 mm along each axis and 4 degrees from its believed pose?

Sentence by sentence in one process, in physics, without a broker: `benchmarks.grasp` does the same with clusters. Half
of the runs have 1.5 times the mass and half the friction. Every second run is of the left arm. A run succeeds if GRASP
does, and both fingers then hold the module. After it no fact flagged valid may be off by more than 5 mm or 2 degrees,
or by more than its spread. The arm must rest. Without cameras (`--touch`) the hand finds the module by touch alone.

    python -m tests.campaigns.grasp [--runs 100] [--touch] [--seed 1]
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from typing import NamedTuple

from benchmarks.grasp import within
from benchmarks.report import question
from rtc.protocol.messages import Validity
from rtc.robot import geometry
from rtc.robot.geometry import Floats
from tests.campaigns import numbered_runs
from tests.workers.conftest import Bench, Physical

SEED = 1
ERROR_M, ERROR_RAD = 0.025, math.radians(4.0)
GRASPS = (("RIGHT", "MACS-NEW", "HANDLE-A"), ("LEFT", "MACS-OLD", "HANDLE-B"))
HEAVY, SMOOTH = 1.5, 0.5
WRONG_M, WRONG_RAD = 0.005, math.radians(2.0)
REST_TICKS, REST_RAD = 200, 1e-3  # an arm at rest turns by less in this time


class Run(NamedTuple):
    grasped: bool
    off_m: float  # of the believed pose
    off_rad: float
    validity: str
    within_spread: bool
    rests: bool
    trims: int
    failed: str

    @property
    def wrong(self) -> bool:
        return self.validity == Validity.VALID and (self.off_m > WRONG_M or self.off_rad > WRONG_RAD)


def offsets(seed: int) -> Iterator[list[float]]:
    """x y z roll pitch yaw (m, rad)."""
    rng = random.Random(seed)
    while True:
        yield [
            *(rng.uniform(-ERROR_M, ERROR_M) for _ in range(3)),
            0.0,
            0.0,
            rng.uniform(-1.0, 1.0) * ERROR_RAD,
        ]


def run(n: int, offset: Floats, touch: bool) -> Run:
    side, module, handle = GRASPS[n % 2]
    subsystem = Physical()
    bench = Bench(subsystem)
    bench.unsurveyed()
    if touch:
        bench.without_cameras()
    if n % 4 < 2:
        subsystem.sim.change_physics(HEAVY, SMOOTH)
    subsystem.displace_and_turn(module, list(offset))
    done = bench.do(f"GRASP {side}-END-EFF {module} {handle}")
    rests = _rests(subsystem, f"{side}-ARM")
    fact = bench.world.get(f"{module}.frame")
    off = geometry.relative(fact.value, subsystem.sim.world.pose(module))
    held = subsystem.sim.held()[f"{side}-ARM"] == [module]
    why = done.failure or done.refusal
    subsystem.close()
    return Run(
        done.succeeded and held,
        math.hypot(*off[:3].tolist()),
        geometry.angle(geometry.IDENTITY, off),
        fact.validity.value,
        fact.spread is None or within([*off[:3].tolist(), *geometry.to_rpy(off).tolist()], fact.spread),
        rests,
        len(done.trims),
        why.message if why else "",
    )


def _rests(subsystem: Physical, arm: str) -> bool:
    before = subsystem.sim.arms[arm].read().joints
    for _ in range(REST_TICKS):
        for executor in subsystem.executors.values():
            executor.tick(0.0)
        subsystem.sim.step()
    return max(abs(a - b) for a, b in zip(before, subsystem.sim.arms[arm].read().joints, strict=True)) < REST_RAD


def main() -> None:
    words = numbered_runs.arguments(__doc__)
    words.add_argument("--touch", action="store_true", help="without cameras; without results file")
    words.add_argument("--seed", type=int, default=SEED, help="another than the default: without results file")
    given = words.parse_args()
    question(
        "grasp", "does a grasp find a module up to 25 mm and 4 degrees off, and are the facts true?", seed=given.seed
    )
    found: list[Run] = []
    for n, offset in numbered_runs.chosen(given, offsets(given.seed)):
        found.append(run(n, offset, given.touch))
        shown = ", ".join(f"{1e3 * x:.0f}" for x in offset[:3])
        print(f"  run {n}: {found[-1]}; displaced {shown} mm, {math.degrees(offset[5]):.1f} deg", flush=True)
    grasped, wrong = sum(one.grasped for one in found), sum(one.wrong for one in found)
    outside = sum(one.validity == Validity.VALID and not one.within_spread for one in found)
    restless = sum(not one.rests for one in found)
    rows = [
        ("grasped", f"{grasped} of {len(found)}"),
        ("facts flagged valid that are off by more than 5 mm or 2 deg", f"{wrong}"),
        ("facts flagged valid that are off by more than their spread", f"{outside}"),
        ("arms that did not rest", f"{restless}"),
    ]
    counts = {"runs": len(found), "grasped": grasped, "wrong": wrong, "outside_spread": outside, "restless": restless}
    metrics: dict[str, float | None] = {name: float(count) for name, count in counts.items()}
    numbered_runs.report("grasp", metrics, rows, kept=not (given.only or given.touch or given.seed != SEED))


if __name__ == "__main__":
    main()
