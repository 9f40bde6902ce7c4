"""Which of the arm's ways to hold its hand there: the nearest that is free and goes on where the task goes on.

`choose` generates the branches nearest first, tests each, and takes the first that passes; when none does, the
refusal tells what is wrong with the nearest, and how many were tried. Pure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec

from rtc.geometry import Array, Floats
from rtc.outcomes import Refusal
from rtc.robot.kinematics import ArmModel
from workers.motion import path

Test = Callable[[Array], Refusal | None]


def choose(
    arm: ArmModel,
    target: Floats,
    near: Floats,
    *,
    then: Sequence[Floats] = (),
    test: Test | None = None,
    margin_rad: float = 0.0,
) -> Array | Refusal:
    """Joints (rad) for the tcp pose `target`, nearest to `near`.

    `then`: poses that the hand will go to from there in straight lines; a branch that cannot follow is not taken.
    `test`: what else must hold, e.g. no collision; it gives the cause when it does not.
    """
    first: Refusal | None = None
    candidates = arm.ik(target, near, margin_rad)
    for joints in candidates:
        problem = (test(joints) if test is not None else None) or _cannot_follow(arm, joints, then, margin_rad, test)
        if problem is None:
            return joints
        first = first or problem
    if first is None:
        unreachable = arm.why_no_ik(target, margin_rad)
        assert unreachable is not None, "no solutions, and yet nothing is wrong"
        return unreachable
    return msgspec.structs.replace(first, detail={**first.detail, "branches_tried": float(len(candidates))})


def _cannot_follow(
    arm: ArmModel, joints: Array, then: Sequence[Floats], margin_rad: float, test: Test | None
) -> Refusal | None:
    for pose in then:
        line = path.task_line(arm, joints, pose, margin_rad)
        if isinstance(line, Refusal):
            return line
        joints = line.knots[-1]
        problem = test(joints) if test is not None else None
        if problem is not None:
            return problem
    return None
