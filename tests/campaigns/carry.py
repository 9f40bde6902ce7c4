"""Do two arms carry one module half a metre, with at most 5 N between them, also if they are halted in the middle?

The right arm of the simulated cell holds a module by friction at one handle. The left hand takes the other handle by a
sentence (GRASP). One command, MOVE BOTH-ARMS, lifts the module by 0.5 m: the right arm leads under position control,
the left arm complies (impedance). Halfway they are halted. Then the grasp is verified, a further command carries the
module on from where it rests, and the right hand lets go of it (RELEASE). Decision Unit, workers and MCM run in one
process. The module is not exactly where both hands expect it: up to 3 mm and 1 degree off in each axis. The force
between the arms is half the difference of the two wrist forces in world axes. What accelerates the module and the hands
does not count. It includes what was there before the motion. If a sentence fails or is refused, its advice is followed
literally, and the run goes on.

    python -m tests.campaigns.carry [--runs 20]
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np

from benchmarks.report import finish, percentile, question
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Outcome, OutcomeKind, StopReason
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.subsystems.base.subsystem import BROKER
from rtc.subsystems.motion.arm import ArmState, HandCommand
from sim_mcm.arms.bullet_arm import BulletCell
from tests.campaigns import RESULTS, advice
from tests.workers.conftest import CELL, MODEL
from tests.workers.one_process import OneProcess

SEED = 9
LEADS, COMPLIES = "RIGHT-ARM", "LEFT-ARM"
HANDLES = {LEADS: "HANDLE-A", COMPLIES: "HANDLE-B"}
MODULE = "MACS-NEW"
START = (0.46, 0.0, 0.55)  # of the middle between the handles (m)
LIFT_M = 0.5
ERROR_M, ERROR_RAD = 0.003, np.radians(1.0)
GRIP_N = 30.0
GRASP = f"GRASP {MODULE} {HANDLES[COMPLIES]} WITH {COMPLIES}"
SENTENCE = "MOVE BOTH-ARMS BY {:.3f} CM ALONG UP"
MARGIN_RAD = 0.05
BEFORE_M = 0.13  # distance of the second hand from its handle at the start
CARRIED = ["succeeded", "halted", "succeeded", "succeeded", "succeeded"]


class Run(NamedTuple):
    outcomes: list[str]  # of the second grasp, both carries, the verification between them, and the release
    causes: list[str]
    between_n: float  # greatest force between the arms in motion
    grasping_n: float  # while the second hand takes the handle
    resting_n: float  # at rest before the motion
    path_m: float
    slip_m: float  # of the module in the leading hand
    error_m: float  # of the hands' distance
    advised: list[advice.Followed]  # the advice of a sentence that neither succeeded nor was halted on purpose


class Carrier:
    """The cell with both hands at the handles of a module."""

    def __init__(self) -> None:
        self._sim = BulletCell(CELL)
        self._state = self._sim.state()
        self._count = 0
        self._outcomes: list[Outcome] = []
        self._advised: list[advice.Followed] = []

    def run(self, offset: Array, lift_m: float = LIFT_M) -> Run:
        """Take the second handle, lift, halt halfway, carry on, let go with the first hand.

        `offset`: of the module from where the hands expect it.
        """
        self._outcomes, self._advised = [], []
        expected = self._place(offset)
        self._grip(LEADS)
        self._know_what_is_held(expected)
        grasping_n = self._do(GRASP)
        resting_n = self._between_n()
        held, apart_m, start = self._module_in_hand(), self._apart_m(), self._tcp(LEADS)
        cluster, between_n = self.cluster, 0.0
        lift = SENTENCE.format(100 * lift_m)
        command = cluster.give(lift)
        while geometry.distance(start, self._tcp(LEADS)) < 0.5 * lift_m and cluster.state.commands:
            cluster.tick()
            between_n = max(between_n, self._between_n())
        cluster.give("HALT BOTH-ARMS")
        between_n = max(between_n, self._until_done())
        self._judge(lift, cluster.outcomes[command])
        between_n = max(between_n, self._do(f"VERIFY {MODULE} AT {LEADS}"))
        left_m = lift_m - geometry.distance(start, self._tcp(LEADS))
        between_n = max(between_n, self._do(SENTENCE.format(100 * left_m)))
        path_m, slip_m = geometry.distance(start, self._tcp(LEADS)), geometry.distance(held, self._module_in_hand())
        error_m = abs(self._apart_m() - apart_m)
        self._do(f"RELEASE {MODULE} WITH {LEADS}")
        return Run(
            outcomes=[outcome.kind.value for outcome in self._outcomes],
            causes=[outcome.message for outcome in self._outcomes if outcome.message],
            between_n=between_n,
            grasping_n=grasping_n,
            resting_n=resting_n,
            path_m=float(path_m),
            slip_m=float(slip_m),
            error_m=error_m,
            advised=self._advised,
        )

    def close(self) -> None:
        self._sim.close()

    # --- the parts of a run ----------------------------------------------------------------------------

    def _place(self, offset: Array) -> Array:
        """The leading hand open at its handle, the other one before its own; the module displaced between the fingers.
        Returns where the module is expected."""
        points = {arm: CELL.object(MODULE).grasp_point(name) for arm, name in HANDLES.items()}
        level = geometry.make_pose((0, 0, 0), (0.0, 2**-0.5, 0.0, 2**-0.5))
        turned = geometry.compose(level, geometry.inverse(points[LEADS].frame.pose))[3:]
        module = geometry.make_pose((0, 0, 0), turned)
        hands = [geometry.compose(module, point.frame.pose)[:3] for point in points.values()]
        module = geometry.translate(module, np.asarray(START) - 0.5 * (hands[0] + hands[1]))
        self._state.poses[MODULE] = geometry.compose(module, geometry.from_rpy(offset[:3], offset[3:])).tolist()
        for arm, point in points.items():
            spec = CELL.arm(arm)
            back_m = BEFORE_M if arm == COMPLIES else 0.0
            tcp = geometry.compose(geometry.compose(module, point.frame.pose), (0.0, 0.0, -back_m, 0.0, 0.0, 0.0, 1.0))
            joints = MODEL.arms[arm].ik(tcp.tolist(), spec.home_rad, MARGIN_RAD)[0]
            width = spec.gripper.max_opening_m
            hand = HandCommand(width, spec.gripper.max_force_n, spec.gripper.speed_m_s)
            self._state.arms[arm] = ArmState(
                joints=joints.tolist(), fingers=(0.5 * width, 0.5 * width), hand=hand, opening_m=width
            )
        self._sim.restore(self._state)
        self.cluster = OneProcess(self._sim)
        return module

    def _grip(self, arm: str) -> None:
        """Close a hand."""
        self._count += 1
        made = p.Primitive(
            id=f"C-900.{self._count}",
            performer=arm,
            trajectory=p.HandMotion(width_m=0.0, force_n=GRIP_N),
            stop_functions=[
                p.StopFunction(reason=StopReason.GOAL, when=p.GoalReached()),
                p.StopFunction(reason=StopReason.TIMEOUT, when=p.TimeAbove(10.0)),
            ],
            control_law=p.ControlLaw(),
        )
        mcm = self.cluster.mcm
        mcm.handle(m.Execute(primitive=made), BROKER, 0.0)
        while not mcm.idle:
            self.cluster.tick()

    def _know_what_is_held(self, expected: Array) -> None:
        """State in the world that the leading hand holds the module. The hand has centred the handle between its
        fingers, and knows nothing else of the module's displacement."""
        hands = {arm: self.cluster.mcm.executors[arm].sample for arm in HANDLES}
        facts = {
            **{f"{arm}.joints": list(sample.joints) for arm, sample in hands.items()},
            **{f"{arm}.hand_width": sum(sample.fingers) for arm, sample in hands.items()},
            f"{LEADS}.holding": MODULE,
            f"{MODULE}.held_by": LEADS,
            f"{MODULE}.grasp": geometry.normalise(geometry.relative(self._tcp(LEADS), expected)).tolist(),
            f"{MODULE}.frame": geometry.normalise(expected).tolist(),
            f"{MODULE}.seat": "",
        }
        self.cluster.know(facts)

    def _do(self, sentence: str) -> float:
        """Give a sentence and run until it has ended; the greatest force between the arms."""
        command = self.cluster.give(sentence)
        between_n = self._until_done()
        self._judge(sentence, self.cluster.outcomes[command])
        return between_n

    def _judge(self, sentence: str, outcome: Outcome) -> None:
        """Keep an outcome, and follow its advice if the sentence was refused or has failed."""
        self._outcomes.append(outcome)
        if outcome.kind not in (OutcomeKind.SUCCEEDED, OutcomeKind.HALTED):
            self._advised.append(advice.follow_in_cluster(self.cluster, sentence, outcome))

    def _until_done(self) -> float:
        """Run until all commands have ended; the greatest force between the arms."""
        between_n = 0.0
        while self.cluster.state.commands:
            self.cluster.tick()
            between_n = max(between_n, self._between_n())
        return between_n

    # --- what is measured ----------------------------------------------------------------------------------

    def _tcp(self, arm: str) -> Array:
        return MODEL.arms[arm].fk(self.cluster.mcm.executors[arm].sample.joints)

    def _between_n(self) -> float:
        forces = []
        for arm in HANDLES:
            wrench = self.cluster.mcm.executors[arm].sample.wrench
            forces.append(geometry.rotate(self._tcp(arm), np.asarray(wrench[:3])))
        return float(0.5 * np.linalg.norm(forces[0] - forces[1]))

    def _module_in_hand(self) -> Array:
        return geometry.relative(self._tcp(LEADS), self._sim.world.pose(MODULE))

    def _apart_m(self) -> float:
        return float(geometry.distance(self._tcp(LEADS), self._tcp(COMPLIES)))


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--runs", type=int, default=20)
    given = words.parse_args()
    question("carry", "do two arms carry one module with at most 5 N between them?", seed=SEED)
    random, carrier = np.random.default_rng(SEED), Carrier()
    runs = []
    for n in range(given.runs):
        offset = random.uniform(-1.0, 1.0, 6) * ([ERROR_M] * 3 + [ERROR_RAD] * 3)
        run = carrier.run(offset)
        runs.append(run)
        print(
            f"  run {n}: {', '.join(run.outcomes)}; {run.between_n:.1f} N, {1e3 * run.slip_m:.1f} mm {run.causes[1:]}",
            flush=True,
        )
        for followed in run.advised:
            print(f"    {followed.end}: {' | '.join(followed.history)}", flush=True)
    carrier.close()
    ends, followed_row = advice.summary(one.end for run in runs for one in run.advised)
    forces = [run.between_n for run in runs]
    done = sum(run.outcomes == CARRIED for run in runs)
    metrics: dict[str, float | None] = {
        "runs": float(len(runs)),
        "carried": float(done),
        "between_p50_n": percentile(forces, 50),
        "between_most_n": max(forces),
        "slip_most_mm": 1e3 * max(run.slip_m for run in runs),
        **ends,
    }
    rows = [
        (
            "taken, halted in the middle, carried on, let go",
            f"{done} of {len(runs)}, {min(r.path_m for r in runs):.3f} m",
        ),
        ("force between the arms", f"p50 {percentile(forces, 50):.1f} N, worst {max(forces):.1f} N"),
        ("while the second hand takes its handle", f"worst {max(run.grasping_n for run in runs):.1f} N"),
        ("at rest after that, before the motion", f"worst {max(run.resting_n for run in runs):.1f} N"),
        ("slip of the module in the leading hand", f"worst {1e3 * max(run.slip_m for run in runs):.1f} mm"),
        ("change of the distance between the hands", f"worst {1e3 * max(run.error_m for run in runs):.1f} mm"),
        followed_row,
    ]
    finish("carry", metrics, rows, RESULTS)


if __name__ == "__main__":
    main()
