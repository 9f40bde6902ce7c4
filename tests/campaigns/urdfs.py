"""Arms of other people: each stands still with its first cell, or is refused with the reason.

    pip install --no-deps --target FOLDER example-robot-data      # of the campaign alone, never of the project
    python -m tests.campaigns.urdfs --data FOLDER [--only NAME ...]

For each URDF of `example-robot-data` and `pybullet_data`: the first cell as `rtc cell new` makes it, all checks of
`rtc cell check`, then two seconds of physics in which no primitive runs: at rest, with the hand open; then with the
hand closed. A short version with URDFs of our own is in `tests/apps/authoring/test_fingers.py`.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pybullet_data

from benchmarks.report import question
from rtc.apps.authoring.draft import draft
from rtc.apps.authoring.review import review
from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import ProgramError
from rtc.subsystems.motion.arm import HandCommand
from rtc.subsystems.motion.executor import Executor
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.period import period
from tests.campaigns.numbered_runs import report

ROBOTS = "cmeel.prefix/share/example-robot-data/robots"
THEIRS = {  # file within ROBOTS -> last link of the arm, if it needs another hand
    "panda_description/urdf/panda.urdf": "",
    "xarm_description/urdf/xarm7.urdf": "",
    "ur_description/urdf/ur3.urdf": "",
    "ur_description/urdf/ur3_gripper.urdf": "",
    "ur_description/urdf/ur5_robot.urdf": "",
    "ur_description/urdf/ur5_gripper.urdf": "",
    "ur_description/urdf/ur10_robot.urdf": "",
    "ur_description/urdf/ur10_joint_limited_robot.urdf": "",
    "kinova_description/robots/kinova.urdf": "",
    "z1_description/urdf/z1.urdf": "",
    "so_arm_description/urdf/so100.urdf": "",
    "so_arm_description/urdf/so101.urdf": "",
    "tiago_description/robots/tiago.urdf": "",
    "tiago_description/robots/tiago_no_hand.urdf": "",
    "talos_data/robots/talos_left_arm.urdf": "",
    "baxter_description/urdf/baxter.urdf": "",
    "asr_twodof_description/urdf/TwoDofs.urdf": "",
    "double_pendulum_description/urdf/double_pendulum.urdf": "",
    "b1_description/urdf/b1-z1.urdf": "",
    "borinot_description/urdf/borinot_flying_arm_2.urdf": "",
}
BULLETS = {
    "franka_panda/panda.urdf": "",
    "kuka_iiwa/model.urdf": "",
    "kuka_iiwa/model_vr_limits.urdf": "",
    "xarm/xarm6_robot.urdf": "",
    "xarm/xarm6_with_gripper.urdf": "link6",
    "TwoJointRobot_w_fixedJoints.urdf": "",
}
TICKS = 1000  # with the hand open, and again with it closed
STILL_RAD = math.radians(0.1)


class Verdict(NamedTuple):
    ended: str  # stands, refused, moves
    words: str
    joints: int = 0
    pads: int = 0


def judge(urdf: Path, tip: str) -> Verdict:
    """Make the first cell of a URDF, check it, and look whether the arm stands still."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            found = draft(urdf, "UNIT", tip)
        except ProgramError as error:
            return Verdict("refused", f"rtc cell new: {error}".replace(str(urdf), urdf.name))
        for name, text in {**found.files, "cell.yaml": found.yaml}.items():
            (Path(folder) / name).parent.mkdir(parents=True, exist_ok=True)
            (Path(folder) / name).write_text(text)
        findings, cell = review(Path(folder) / "cell.yaml")
    errors = [f"{one.where}: {one.problem}" for one in findings if one.severity == "error"]
    if errors or cell is None:
        return Verdict("refused", f"rtc cell check: {'; '.join(errors)}")
    return _at_rest(cell)


def _at_rest(cell: Cell) -> Verdict:
    sim = BulletCell(cell)
    try:
        arm = sim.arms["UNIT"]
        executor, at, far = Executor(arm), np.array(arm.read().joints), 0.0
        for width_m in (cell.arms[0].gripper.max_opening_m, 0.0):
            arm.command_hand(HandCommand(width_m, 30.0, 0.1))
            for tick in range(TICKS):
                period(executor.tick, sim, 1e-3 * tick)
                far = max(far, float(np.abs(np.array(arm.read().joints) - at).max()))
        stands = far < STILL_RAD and executor.at_rest and not executor.strayed
        words = f"joints within {math.degrees(far):.4f} deg or {1e3 * far:.4f} mm"
        return Verdict("stands" if stands else "moves", words, len(at), len(cell.seats))
    finally:
        sim.close()


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--data", type=Path, help="folder with example-robot-data; without it pybullet_data alone")
    words.add_argument("--only", nargs="+", help="files whose name contains one of these, without results file")
    given = words.parse_args()
    question("urdfs", "does each arm stand still with its first cell, or is it refused?")
    files = {Path(pybullet_data.getDataPath()) / name: tip for name, tip in BULLETS.items()}
    if given.data is not None:
        files = {given.data / ROBOTS / name: tip for name, tip in THEIRS.items()} | files
    rows, counts = [], dict.fromkeys(("stands", "refused", "moves"), 0)
    with_pads = 0
    for file, tip in files.items():
        if given.only and not any(part in str(file) for part in given.only):
            continue
        verdict = judge(file, tip)
        counts[verdict.ended] += 1
        with_pads += bool(verdict.pads)
        what = f", {verdict.joints} joints, {verdict.pads} pads" if verdict.joints else ""
        rows.append((f"{file.parent.name}/{file.name}", f"{verdict.ended}: {verdict.words}{what}"))
        print(*rows[-1], flush=True)
    metrics = {name: float(count) for name, count in counts.items()} | {"with pads": float(with_pads)}
    report("urdfs", metrics, rows, kept=not given.only and given.data is not None)


if __name__ == "__main__":
    main()
