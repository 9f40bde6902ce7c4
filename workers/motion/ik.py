"""Which of the arm's ways to hold its hand there: the nearest that is free and goes on where the task goes on.

`choose` generates the branches nearest first, tests each, and takes the first that passes; when none does, the
refusal tells what is wrong with the nearest, and how many were tried. Pure.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from rtc.geometry import Array, Floats
from rtc.outcomes import Refusal
from rtc.robot.kinematics import ArmModel

Test = Callable[[Array], Refusal | None]


def choose(
    arm: ArmModel,
    target: Floats,
    near: Floats,
    *,
    test: Test | None = None,
    margin_rad: float = 0.0,
) -> Array | Refusal:
    """Joints (rad) for the tcp pose `target`, nearest to `near`.

    `test`: what else must hold, e.g. no collision; it gives the cause when it does not.
    """
    first: Refusal | None = None
    candidates = arm.ik(target, near, margin_rad)
    for joints in candidates:
        problem = test(joints) if test is not None else None
        if problem is None:
            return joints
        first = first or problem
    if first is None:
        unreachable = arm.why_no_ik(target, margin_rad)
        assert unreachable is not None, "no solutions, and yet nothing is wrong"
        return unreachable
    return msgspec.structs.replace(first, detail={**first.detail, "branches_tried": float(len(candidates))})
