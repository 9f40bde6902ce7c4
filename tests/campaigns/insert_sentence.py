"""Does a compliant arm bring a module into a seat that is not where it is believed to be?

The right arm of the simulated cell holds a module by friction alone, before the bay. The bay is displaced by up to
2 mm along each axis and turned by up to 1 degree about each, without the knowledge of the arm. Then one sentence,
INSERT, carries the module over the lips and into the slot (1.5 mm of clearance), tugs at it, lets go and backs off. A
run succeeds if the command does, and the module then rests in the seat: within 4 mm and 0.05 rad of its seated place,
where the catch holds it. For comparison, the same errors with PLACE, which is position-controlled (`--rigid`).

    python -m tests.campaigns.insert_sentence [--runs 100]
"""

from __future__ import annotations

import pybullet

from benchmarks.report import question
from rtc.protocol import primitive as p
from rtc.robot import geometry
from rtc.robot.geometry import Array
from sim_mcm.arms.detents import CATCHES_M, CATCHES_RAD
from sim_mcm.control.executor import Executor
from tests.campaigns.seating import ARM, BAY, BEFORE, MODULE, SEED, Run, options, run_all, write_report
from tests.workers.conftest import CELL, Bench, Physical

INSERT, PLACE = f"INSERT {MODULE} INTO {BAY} WITH {ARM}", f"PLACE {MODULE} ON {BAY} WITH {ARM}"


class Inserter:
    """The arm with the module in its hand before the bay, and this state to return to."""

    def __init__(self) -> None:
        self.subsystem = Physical()
        self.bench = Bench(self.subsystem)
        self.sim = self.subsystem.sim
        for sentence in BEFORE:
            run = self.bench.do(sentence)
            assert run.succeeded, (sentence, run.refusal, run.assessments)
        self._law = p.ControlLaw(load=run.primitives[-1].control_law.load, gains=run.primitives[-1].control_law.gains)
        self._saved = pybullet.saveState(physicsClientId=self.sim.world.client)
        self._world = self.bench.world
        executor = self.subsystem.executors[ARM]
        self._joints, self._hand = list(executor._command[0]), executor._hand

    def run(self, offset: Array, rigid: bool) -> Run:
        """One insertion with the bay displaced by `offset` (x y z roll pitch yaw; m, rad)."""
        self._restore()
        world, home = self.sim.world, CELL.seat(BAY).frame.pose
        seat = world.seats[BAY]
        seat.home = geometry.compose(home, geometry.from_rpy(offset[:3], offset[3:]))
        world.place(seat, seat.home)
        done = self.bench.do(PLACE if rigid else INSERT)
        place = geometry.compose(seat.home, CELL.seat(BAY).module_frame.pose)
        pose = world.pose(MODULE)
        off_m, off_rad = geometry.distance(pose, place), geometry.angle(pose, place)
        seated = done.succeeded and off_m < CATCHES_M and off_rad < CATCHES_RAD and not self.sim.held()[ARM]
        why = done.failure or done.refusal
        peak_n = max((report.peak_force_n for report in done.reports[1:]), default=0.0)
        return Run(seated, off_m, off_rad, peak_n, len(done.trims), why.message if why else "")

    def _restore(self) -> None:
        """Back to the state before the first run: the world, and what its controller commands."""
        self.sim._detents.let_go_all()
        pybullet.restoreState(self._saved, physicsClientId=self.sim.world.client)
        self.bench.world = self._world
        still = [0.0] * len(self._joints)
        arm = self.sim.arms[ARM]
        arm.use_law(self._law)
        arm.follow((self._joints, still, still))
        arm.command_hand(self._hand)
        arm._hand.wanted_m = 0.0  # the spring of the grip is stretched
        for name, other in self.sim.arms.items():
            other.read()
            self.subsystem.executors[name] = Executor(other)
        self.subsystem.executors[ARM]._hand = self._hand


def main() -> None:
    given = options(__doc__)
    question(
        "insert_sentence", f"does {'PLACE' if given.rigid else 'INSERT'} seat a module in a displaced seat?", seed=SEED
    )
    inserter = Inserter()
    found = run_all(lambda offset: inserter.run(offset, given.rigid), given.runs)
    write_report("insert_sentence", found, write=not given.rigid)


if __name__ == "__main__":
    main()
