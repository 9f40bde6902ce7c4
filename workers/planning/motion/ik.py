"""Choice among the inverse kinematics branches of a pose: the nearest one that passes a test. Pure.

If no branch passes, the refusal states the problem of the nearest branch and the number of branches tried.
"""

from __future__ import annotations

from collections.abc import Callable

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.outcomes import Refusal, Refused
from rtc.spatial.geometry import Array, Floats

Test = Callable[[Array], Refusal | None]


def choose(
    arm: ArmModel,
    target: Floats,
    near: Floats,
    *,
    test: Test | None = None,
    margin_rad: float = 0.0,
) -> Array:
    """Joint values (rad) for the tcp pose `target` (world), nearest to `near` (rad).

    `test`: further condition, such as no collision; returns the refusal if it fails. Raises Refused.
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
        raise Refused(unreachable)
    raise Refused(first.after(branches_tried=len(candidates)))
