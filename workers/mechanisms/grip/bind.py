"""A hand that opens or closes: how wide, and with which force. Pure."""

from __future__ import annotations

from rtc.protocol.causes import Cause, GripForceExceeded, OpeningExceeded
from rtc.protocol.messages import BoundStep, EvaluationContext, GripStep
from rtc.protocol.outcomes import RefusalReason, Refused, StopReason
from rtc.protocol.primitive import HandMotion
from rtc.protocol.units import in_words
from workers.conditions import prediction
from workers.tasks import assemble
from workers.tasks.bind_task import BindTask, unknown_in_program

HELD = "still_held"  # effect of a hand that closes on what it holds
MIN_WIDTH_M = 1e-6  # rounding tolerance of the hand's range


def bind_hand(task: BindTask) -> BoundStep:
    """The hand opens or closes (`op`); a second arm that holds nothing yet is left as it is. Raises Refused."""
    step = task.data.step.of_kind(GripStep)
    if step.arm and step.effect == HELD and not task.held:
        return BoundStep(note=f"{task.arm} holds nothing yet")
    return hand_motion(task, step.op)


def hand_motion(task: BindTask, op: str) -> BoundStep:
    """Open the hand to a width, or close it until it grips an object or is fully closed. Raises Refused."""
    if op not in task.program.hand:
        raise unknown_in_program("motion of a hand", op, task.program.hand)
    ruled = task.under(task.program.hand[op])
    values, query, gripper = ruled.values, task.query, task.query.cell.arm(task.arm).gripper
    width_m = values.get("width_m", 0.0)
    grip_n = task.data.context.limits.grip_force_n or values.get("grip_n", values["hand_n"])
    opening = OpeningExceeded(value_m=width_m, limit_m=gripper.max_opening_m, arm=task.arm)
    grip = GripForceExceeded(value_n=grip_n, limit_n=gripper.max_force_n, arm=task.arm)
    for name, value, most, unit, cause in (
        ("opening", width_m, gripper.max_opening_m, "m", opening),
        ("grip force", grip_n, gripper.max_force_n, "N", grip),
    ):
        if not -MIN_WIDTH_M <= value <= most + MIN_WIDTH_M:
            raise _refused_hand_figure(task, name, value, most, unit, cause)
    evaluation = EvaluationContext(
        context=task.data.context,
        step=task.data.step,
        arm=task.arm,
        goal_pose=query.tcp(task.arm).tolist(),
        held=task.held,
        no_contact_is_failure=StopReason.GOAL not in task.data.step.expect,
        width_m=[values.get("least_m", 0.0), values.get("most_m", gripper.max_opening_m + 0.001)],
        start_joints=list(query.joints(task.arm)),
    )
    motion = HandMotion(width_m=width_m, force_n=grip_n, speed_m_s=gripper.speed_m_s)
    expected = prediction.of_hand(query, values, evaluation, motion)
    return assemble.of_arm(ruled, motion, evaluation, expected)


def _refused_hand_figure(task: BindTask, name: str, value: float, most: float, unit: str, cause: Cause) -> Refused:
    hand = task.query.cell.arm(task.arm).end_effector
    now = f"; it is open {in_words(task.query.hand_width(task.arm), 'm')} now" if unit == "m" else ""
    return Refused.because(
        RefusalReason.INFEASIBLE,
        f"{name} of {hand}: {in_words(value, unit)} is asked for; it can have 0 to {in_words(most, unit)}{now}",
        clears=f"{name} of 0 to {in_words(most, unit)}",
        cause=cause,
    )


def open_hand(task: BindTask) -> BoundStep:
    """Open the empty hand to the width required before a grasp."""
    held = task.query.holding(task.arm)
    if held:
        message = f"{task.arm} already holds {held}"
        raise Refused.because(RefusalReason.STATE, message, clears=f"let go of {held}")
    return hand_motion(task, "open")
