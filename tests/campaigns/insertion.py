"""Does a compliant arm bring a module into a seat that is not where it is believed to be?

The right arm of the simulated cell holds a module by friction alone, before the bay. The bay is displaced by up to
2 mm along each axis and turned by up to 1 degree about each, without the knowledge of the arm. The hand then follows
the nominal straight line under impedance, over the lips and into the slot (1.5 mm of clearance). After a jam it
backs off and tries again with another stiffness in rotation, then turned by 0.6 degrees, at most six times. A run
succeeds if the module rests in the seat: within 4 mm and 0.05 rad of its seated place, where the catch holds it. For
comparison, the same errors under position control (`--rigid`).

    python -m tests.campaigns.insertion [--runs 100]
"""

from __future__ import annotations

import pybullet

from benchmarks.force import straight
from benchmarks.report import question
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.robot import geometry
from rtc.robot.geometry import Array
from sim_mcm.arms.detents import CATCHES_M, CATCHES_RAD
from sim_mcm.control.executor import Executor
from tests.campaigns.seating import ARM, BAY, BEFORE, MODULE, SEED, Run, options, run_all, write_report
from tests.workers.conftest import CELL, Bench, Physical

GAINS = {"wn": 100.0}
T = 0.010
STIFFNESS_N_M = 400.0
# Stiffness in rotation (N.m/rad), and rotation of the goal (rad, world y and z): of the first attempt, then after jams
ATTEMPTS = ((2.0, 0.0, 0.0), (5.0, 0.0, 0.0), *((2.0, y, z) for y, z in ((T, 0.0), (-T, 0.0), (0.0, T), (0.0, -T))))
JAM_M, JAM_N, BACK_M = 0.060, 15.0, 0.070  # behind the command with this force: a jam; then back by this
PULL_N, PULL_NM = 30.0, 6.0  # greatest pull of the spring
SPEED_M_S = 0.03
START_M, BEYOND_M = 0.30, 0.004  # before the seat; beyond the nominal seated place
LIMIT_N = 80.0


class Inserter:
    """The arm with the module in its hand before the bay, and this state to return to."""

    def __init__(self) -> None:
        bench = Bench(Physical())
        self.cell, self.model = CELL, bench.model.arms[ARM]
        self.world = bench.subsystem.sim
        self.executor = bench.subsystem.executors[ARM]
        self.home = CELL.seat(BAY).frame.pose
        for sentence in BEFORE:
            run = bench.do(sentence)
            assert run.succeeded, (sentence, run.refusal, run.assessments)
        self.load = run.primitives[-1].control_law.load
        self._saved = pybullet.saveState(physicsClientId=self.world.world.client)
        self._joints = list(self.executor._command[0])
        self._count = 0

    def run(self, offset: Array, rigid: bool) -> Run:
        """One insertion with the bay displaced by `offset`."""
        world = self.world
        self._restore()
        seat = world.world.seats[BAY]
        seat.home = geometry.compose(self.home, geometry.from_rpy(offset[:3], offset[3:]))
        world.world.place(seat, seat.home)
        goal = geometry.translate(self.model.fk(self._joints), (START_M + BEYOND_M, 0.0, 0.0))
        peak_n, tries = 0.0, 0
        for turning, y_rad, z_rad in ATTEMPTS:
            tries += 1
            tilt = geometry.from_rpy((0, 0, 0), (0, y_rad, z_rad))
            turned = geometry.make_pose(goal[:3], geometry.compose(tilt, (0, 0, 0, *goal[3:]))[3:])
            report = self._go_in(turned, turning, rigid)
            peak_n = max(peak_n, report.peak_force_n)
            if rigid or report.reason is StopReason.GOAL:
                break
        place = geometry.compose(seat.home, self.cell.seat(BAY).module_frame.pose)
        pose = world.world.pose(MODULE)
        off_m, off_rad = geometry.distance(pose, place), geometry.angle(pose, place)
        held = world.held()[ARM] == [MODULE]
        return Run(held and off_m < CATCHES_M and off_rad < CATCHES_RAD, off_m, off_rad, peak_n, tries - 1)

    def _go_in(self, goal: Array, turning: float, rigid: bool) -> m.EndReport:
        """Follow the line from here to `goal`. A jam makes the arm back off."""
        start = self.executor._command[0]
        stops = [
            p.StopFunction(reason=StopReason.GOAL, when=p.GoalReached()),
            p.StopFunction(reason=StopReason.FORCE_LIMIT, when=p.ForceAbove(limit_n=LIMIT_N)),
            p.StopFunction(reason=StopReason.TIMEOUT, when=p.TimeAbove(30.0)),
        ]
        law = p.ControlLaw(load=self.load, gains=GAINS)
        if not rigid:
            stiffness = [STIFFNESS_N_M] * 3 + [turning] * 3
            compliance = p.Compliance(stiffness=stiffness, most_n=PULL_N, most_nm=PULL_NM)
            law = p.ControlLaw(name="impedance", load=self.load, gains=GAINS, compliance=compliance)
            jam = p.NoProgress(behind_m=JAM_M, force_n=JAM_N)
            back = {"reflex": Reflex.BACK_OFF, "back_off_m": BACK_M}
            stops.append(p.StopFunction(reason=StopReason.FORCE_LIMIT, when=jam, **back))  # type: ignore[arg-type]
        path = straight(self.model, start, goal, SPEED_M_S)
        self._count += 1
        made = p.Primitive(
            id=f"C-9.{self._count}", performer=ARM, trajectory=path, stop_functions=stops, control_law=law
        )
        return self._perform(made)

    def _perform(self, made: p.Primitive) -> m.EndReport:
        messages = self.executor.accept(made, 0.0)
        while not any(isinstance(message, m.EndReport) for message in messages):
            self.world.step()
            messages = self.executor.tick(0.0)
        return messages[-1]

    def _restore(self) -> None:
        """Back to the state before the first run: the world, and what its controller commands."""
        self.world._detents.let_go_all()
        pybullet.restoreState(self._saved, physicsClientId=self.world.world.client)
        still = [0.0] * len(self._joints)
        arm = self.world.arms[ARM]
        arm.follow((self._joints, still, still))
        arm.use_law(p.ControlLaw(load=self.load, gains=GAINS))
        for other in self.world.arms.values():
            other.read()
        self.executor = Executor(arm)


def main() -> None:
    given = options(__doc__)
    law = "position control" if given.rigid else "impedance"
    question("insertion", f"does a module go into a displaced seat under {law}?", seed=SEED)
    inserter = Inserter()
    found = run_all(lambda offset: inserter.run(offset, given.rigid), given.runs)
    write_report("insertion", found, write=not given.rigid)


if __name__ == "__main__":
    main()
