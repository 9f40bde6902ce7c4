"""Does a compliant arm bring a module into a seat that is not where it is believed to be?

The scene is that of `tests.campaigns.displaced_seat`. The hand follows the nominal straight line under impedance, over
the lips and into the slot (1.5 mm of clearance), by primitives without a sentence. After a jam it backs off and tries
again with another stiffness in rotation, then turned by 0.6 degrees, at most six times. For comparison, the same errors
under position control (`--rigid`).

    python -m tests.campaigns.insertion [--runs 100]
"""

from __future__ import annotations

from functools import partial

from benchmarks.force import straight
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from sim_mcm.period import period
from tests.campaigns.displaced_seat import ARM, BeforeBay, Run, arguments, campaign
from tests.workers.conftest import MODEL

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


class Inserter(BeforeBay):
    """Inserts by primitives."""

    def __init__(self, rigid: bool) -> None:
        super().__init__()
        self._rigid, self._count = rigid, 0
        self._model = MODEL.arms[ARM]

    def run(self, offset: Array) -> Run:
        self.displace(offset)
        goal = geometry.translate(self._model.fk(self.joints), (START_M + BEYOND_M, 0.0, 0.0))
        peak_n, tries = 0.0, 0
        for turning, y_rad, z_rad in ATTEMPTS:
            tries += 1
            tilt = geometry.from_rpy((0, 0, 0), (0, y_rad, z_rad))
            turned = geometry.make_pose(goal[:3], geometry.compose(tilt, (0, 0, 0, *goal[3:]))[3:])
            report = self._go_in(turned, turning)
            peak_n = max(peak_n, report.peak_force_n)
            if self._rigid or report.reason is StopReason.GOAL:
                break
        return self.judge(True, peak_n, tries)

    def _go_in(self, goal: Array, turning: float) -> m.EndReport:
        """Follow the line from here to `goal`. A jam makes the arm back off."""
        start = self.subsystem.executors[ARM].command[0]
        stops = [
            p.StopFunction(reason=StopReason.GOAL, when=p.GoalReached()),
            p.StopFunction(reason=StopReason.FORCE_LIMIT, when=p.ForceAbove(limit_n=LIMIT_N)),
            p.StopFunction(reason=StopReason.TIMEOUT, when=p.TimeAbove(30.0)),
        ]
        law = p.ControlLaw(load=self.load, gains=GAINS)
        if not self._rigid:
            stiffness = [STIFFNESS_N_M] * 3 + [turning] * 3
            compliance = p.Compliance(stiffness=stiffness, most_n=PULL_N, most_nm=PULL_NM)
            law = p.ControlLaw(name="impedance", load=self.load, gains=GAINS, compliance=compliance)
            jam = p.NoProgress(behind_m=JAM_M, force_n=JAM_N)
            back = {"reflex": Reflex.BACK_OFF, "back_off_m": BACK_M}
            stops.append(p.StopFunction(reason=StopReason.FORCE_LIMIT, when=jam, **back))  # type: ignore[arg-type]
        path = straight(self._model, start, goal, SPEED_M_S)
        self._count += 1
        made = p.Primitive(
            id=f"C-9.{self._count}", performer=ARM, trajectory=path, stop_functions=stops, control_law=law
        )
        return self._perform(made)

    def _perform(self, made: p.Primitive) -> m.EndReport:
        executor = self.subsystem.executors[ARM]
        messages = executor.accept(made, 0.0)
        while not any(isinstance(message, m.EndReport) for message in messages):
            messages = period(executor.tick, self.sim, 0.0)
        return messages[-1]


def main() -> None:
    given = arguments(__doc__).parse_args()
    law = "position control" if given.rigid else "impedance"
    campaign("insertion", f"does a module go into a displaced seat under {law}?", partial(Inserter, given.rigid), given)


if __name__ == "__main__":
    main()
