"""Do two arms carry one module half a metre, with at most 5 N between them, also if they are halted in the middle?

Both arms of the simulated cell hold a module by friction, each at one handle. The right arm leads under position
control, the left arm complies (impedance). They lift the module by 0.5 m; halfway they are halted, and then carry it
on from where they rest. The module is not exactly where both hands expect it: up to 3 mm and 1 degree off in each
axis. The force between the arms is half the difference of the two wrist forces in world axes: what accelerates the
module and the hands does not count. It includes what was there before the motion.

    python -m tests.campaigns.carry [--runs 20] [--speed 0.15]
"""

from __future__ import annotations

import argparse
from typing import Any, NamedTuple

import numpy as np

from benchmarks.report import finish, percentile, question
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Refusal, StopReason
from rtc.robot import geometry
from rtc.robot.geometry import Array
from rtc.subsystem.subsystem import BROKER
from sim_mcm.arms.arm import ArmState, HandCommand
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.control.subsystem import McmSubsystem
from tests.campaigns import RESULTS
from tests.workers.conftest import CELL, MODEL
from workers.planning.motion.carry import carry_along
from workers.planning.motion.path import task_line
from workers.planning.motion.timing import Pace, Timed, time_path

SEED = 9
LEADS, COMPLIES = "RIGHT-ARM", "LEFT-ARM"
HANDLES = {LEADS: "HANDLE-A", COMPLIES: "HANDLE-B"}
MODULE = "MACS-NEW"
START = (0.48, 0.0, 0.70)  # of the middle between the handles (m)
LIFT_M = 0.5
ERROR_M, ERROR_RAD = 0.003, np.radians(1.0)
STIFFNESS = [600.0] * 3 + [30.0] * 3
GRIP_N, PULL_N, LIMIT_N = 30.0, 20.0, 40.0
MARGIN_RAD = 0.05


class Run(NamedTuple):
    reasons: list[str]  # of the end reports
    between_n: float  # greatest force between the arms in motion
    resting_n: float  # and at rest before it
    path_m: float
    slip_m: float  # of the module in the leading hand
    error_m: float  # of the hands' distance


class Carrier:
    """The cell with both hands at the handles of a module."""

    def __init__(self) -> None:
        self._sim = BulletCell(CELL)
        self._state = self._sim.state()
        self._count = 0

    def run(self, offset: Array, speed_m_s: float, lift_m: float = LIFT_M) -> Run:
        """Grip, lift, halt halfway, carry on. `offset`: of the module from where the hands expect it."""
        self._place(offset)
        for arm in HANDLES:
            self._grip(arm)
        resting_n = self._between_n()
        held, apart_m = self._module_in_hand(), self._apart_m()
        start = self._tcp(LEADS)
        goal = geometry.translate(start, (0.0, 0.0, lift_m))
        first = self._carry(goal, speed_m_s, halt_at_m=0.5 * lift_m)
        second = self._carry(goal, speed_m_s)
        moved = self._module_in_hand()
        return Run(
            reasons=[first[0], second[0]],
            between_n=max(first[1], second[1]),
            resting_n=resting_n,
            path_m=float(geometry.distance(start, self._tcp(LEADS))),
            slip_m=float(geometry.distance(held, moved)),
            error_m=abs(self._apart_m() - apart_m),
        )

    def close(self) -> None:
        self._sim.close()

    # --- the parts of a run ----------------------------------------------------------------------------

    def _place(self, offset: Array) -> None:
        """Both arms at the handles with open hands; the module displaced between the fingers."""
        points = {arm: CELL.object(MODULE).grasp_point(name) for arm, name in HANDLES.items()}
        middle = geometry.make_pose(START, (0.0, 2**-0.5, 0.0, 2**-0.5))
        module = geometry.make_pose((0, 0, 0), geometry.compose(middle, geometry.inverse(points[LEADS].frame.pose))[3:])
        hands = [geometry.compose(module, point.frame.pose)[:3] for point in points.values()]
        module = geometry.translate(module, np.asarray(START) - 0.5 * (hands[0] + hands[1]))
        self._state.poses[MODULE] = geometry.compose(module, geometry.from_rpy(offset[:3], offset[3:])).tolist()
        for arm, point in points.items():
            spec = CELL.arm(arm)
            tcp = geometry.compose(module, point.frame.pose)
            joints = MODEL.arms[arm].ik(tcp.tolist(), spec.home_rad, MARGIN_RAD)[0]
            width = spec.gripper.max_opening_m
            hand = HandCommand(width, spec.gripper.max_force_n, spec.gripper.speed_m_s)
            self._state.arms[arm] = ArmState(
                joints=joints.tolist(), fingers=(0.5 * width, 0.5 * width), hand=hand, opening_m=width
            )
        self._sim.restore(self._state)
        self.mcm = McmSubsystem(self._sim.arms, pid=1)

    def _grip(self, arm: str) -> None:
        motion = p.HandMotion(width_m=0.0, force_n=GRIP_N)
        soft = p.ControlLaw(name="impedance", compliance=p.Compliance(stiffness=STIFFNESS, most_n=PULL_N))
        law = soft if arm == COMPLIES else p.ControlLaw()
        made = p.Primitive(
            id=self._name(), performer=arm, trajectory=motion, stop_functions=_stops(limit_n=200.0), control_law=law
        )
        report = self._perform(made)[0]
        assert report.reason is StopReason.GOAL, report

    def _carry(self, goal: Array, speed_m_s: float, halt_at_m: float | None = None) -> tuple[str, float]:
        """One two-arm primitive from here to `goal` of the leading hand; its reason, and the greatest force between."""
        start = {arm: np.asarray(self.mcm.executors[arm].sample.joints) for arm in HANDLES}
        line = task_line(MODEL.arms[LEADS], start[LEADS], goal, MARGIN_RAD)
        assert not isinstance(line, Refusal), line
        timed = time_path(MODEL.arms[LEADS], line, Pace(speed_m_s, 0.5))
        assert not isinstance(timed, Refusal), timed
        both = carry_along(MODEL.arms[LEADS], timed, MODEL.arms[COMPLIES], start[COMPLIES], MARGIN_RAD)
        assert not isinstance(both, Refusal), both
        report, between_n = self._perform(self._pair(*both), halt_at_m)
        return report.reason.value, between_n

    def _pair(self, leads: Timed, follows: Timed) -> p.Primitive:
        compliance = p.Compliance(stiffness=STIFFNESS, most_n=PULL_N)
        half = p.Load(mass_kg=1.0, com_m=[0.0, 0.0, 0.15], inertia_kg_m2=[0.007, 0.006, 0.008, 0.0, 0.0, 0.0])
        partner = p.Partner(
            performer=COMPLIES,
            trajectory=follows.trajectory(),
            control_law=p.ControlLaw(name="impedance", load=half, gains={"wn": 100.0}, compliance=compliance),
            stop_functions=_stops(LIMIT_N),
        )
        law = p.ControlLaw(load=half, gains={"wn": 100.0})
        return p.Primitive(
            id=self._name(),
            performer=LEADS,
            trajectory=leads.trajectory(),
            stop_functions=_stops(LIMIT_N),
            control_law=law,
            partner=partner,
        )

    def _perform(self, made: p.Primitive, halt_at_m: float | None = None) -> tuple[m.EndReport, float]:
        start, between_n = self._tcp(LEADS), 0.0
        sent: list[Any] = self.mcm.handle(m.Execute(primitive=made), BROKER, 0.0)
        while True:
            for _, message in sent:
                if isinstance(message, m.EndReport) and message.primitive == made.id:
                    self.mcm.handle(m.ReportAck(primitive=made.id), BROKER, 0.0)
                    return message, between_n
            self._sim.step()
            sent = self.mcm.tick(0.0)
            between_n = max(between_n, self._between_n())
            if halt_at_m is not None and geometry.distance(start, self._tcp(LEADS)) > halt_at_m:
                halt_at_m = None
                sent += self.mcm.handle(m.HaltOrder(halt="middle", scope="ALL"), BROKER, 0.0)

    # --- what is measured ----------------------------------------------------------------------------------

    def _tcp(self, arm: str) -> Array:
        return MODEL.arms[arm].fk(self.mcm.executors[arm].sample.joints)

    def _between_n(self) -> float:
        forces = []
        for arm in HANDLES:
            wrench = self.mcm.executors[arm].sample.wrench
            forces.append(geometry.rotate(self._tcp(arm), np.asarray(wrench[:3])))
        return float(0.5 * np.linalg.norm(forces[0] - forces[1]))

    def _module_in_hand(self) -> Array:
        return geometry.relative(self._tcp(LEADS), self._sim.world.pose(MODULE))

    def _apart_m(self) -> float:
        return float(geometry.distance(self._tcp(LEADS), self._tcp(COMPLIES)))

    def _name(self) -> str:
        self._count += 1
        return f"C-9.{self._count}"


def _stops(limit_n: float) -> list[p.StopFunction]:
    return [
        p.StopFunction(reason=StopReason.GOAL, when=p.GoalReached()),
        p.StopFunction(reason=StopReason.FORCE_LIMIT, when=p.ForceAbove(limit_n=limit_n)),
        p.StopFunction(reason=StopReason.TIMEOUT, when=p.TimeAbove(60.0)),
    ]


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--runs", type=int, default=20)
    words.add_argument("--speed", type=float, default=0.15, help="m/s")
    given = words.parse_args()
    question("carry", "do two arms carry one module with at most 5 N between them?", seed=SEED)
    random, carrier = np.random.default_rng(SEED), Carrier()
    runs = []
    for n in range(given.runs):
        offset = random.uniform(-1.0, 1.0, 6) * ([ERROR_M] * 3 + [ERROR_RAD] * 3)
        run = carrier.run(offset, given.speed)
        runs.append(run)
        print(f"  run {n}: {', '.join(run.reasons)}; {run.between_n:.1f} N, {1e3 * run.slip_m:.1f} mm", flush=True)
    carrier.close()
    forces = [run.between_n for run in runs]
    done = sum(run.reasons == ["halt", "goal"] for run in runs)
    metrics: dict[str, float | None] = {
        "runs": float(len(runs)),
        "carried": float(done),
        "between_p50_n": percentile(forces, 50),
        "between_most_n": max(forces),
        "slip_most_mm": 1e3 * max(run.slip_m for run in runs),
    }
    rows = [
        ("halted in the middle and carried on", f"{done} of {len(runs)}, {min(r.path_m for r in runs):.3f} m"),
        ("force between the arms", f"p50 {percentile(forces, 50):.1f} N, worst {max(forces):.1f} N"),
        ("of it at rest, before the motion", f"worst {max(run.resting_n for run in runs):.1f} N"),
        ("slip of the module in the leading hand", f"worst {1e3 * max(run.slip_m for run in runs):.1f} mm"),
        ("change of the distance between the hands", f"worst {1e3 * max(run.error_m for run in runs):.1f} mm"),
    ]
    finish("carry", metrics, rows, RESULTS)


if __name__ == "__main__":
    main()
