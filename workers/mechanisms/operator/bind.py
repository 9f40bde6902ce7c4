"""A step that the operator performs: the request, what it grants, and what DONE must prove. Pure.

The request has no numbers: those of the step are for the subsystem and the analyzer. The stop functions are those of
any motion; so the limits of the sentence hold, and a distance from all that the command is not about.
"""

from __future__ import annotations

import math
from typing import Any

import msgspec

from rtc.protocol.messages import BoundStep, EvaluationContext, OperateStep, SharedStep, Step
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.primitive import TeleopMotion
from rtc.protocol.sentence import SHARED_AXES
from workers.conditions.prediction import Expected
from workers.planning import shared_hold
from workers.tasks import assemble, targets
from workers.tasks.bind_task import BindTask, RuledTask, refused_program
from workers.tasks.motion import motion_to_share

HAND, SPINDLE = "hand", "spindle"  # the word `operator_has` of a step
PLACE = {0, 1, 2}  # axes of a twist that move the tcp
PRESSES = 0.5  # share of the grip force that proves a grip


def bind_operated(task: BindTask) -> BoundStep:
    """The step as a request to the operator. Raises Refused."""
    shared_hold.refuse_alone(task.query, task.arm, "", task.program.clears)
    step = task.data.step.of_kind(OperateStep)
    ruled = task.under(step.stop)
    values, pose = ruled.values, _place(task, step.place)
    hand = _hand(ruled) if step.operator_has == HAND else {}
    spindle = _spindle(ruled, step.by_turns) if step.operator_has == SPINDLE else {}
    motion = TeleopMotion(
        request=_request(task),
        speed_m_s=values["speed_m_s"],
        turn_rad_s=values["turn_rad_s"],
        centre=pose[:3] if pose else [],
        radius_m=values["reach_m"] if pose else math.inf,
        done_m=step.within_m if pose else None,
        **hand,
        **spindle,
    )
    return _bound(ruled, motion, pose or None, [values["least_m"], values["most_m"]] if hand else None)


def bind_shared(task: BindTask) -> BoundStep:
    """The step as a way of the program, on which some axes are the operator's. Raises Refused."""
    shared_hold.refuse_alone(task.query, task.arm, "", task.program.clears)
    step, part = task.data.step.of_kind(SharedStep), task.data.context.limits.shared
    if part is None or step.within_m is None:
        raise refused_program(
            "a shared motion needs the part that the operator has, and within_m", "both in the script"
        )
    ruled, goal = task.under(step.stop), _place(task, step.place)
    way, axes = motion_to_share(ruled, step), SHARED_AXES[part]
    motion = TeleopMotion(
        request=_request(task),
        speed_m_s=ruled.values["speed_m_s"],
        turn_rad_s=ruled.values["turn_rad_s"],
        along=way.timed.trajectory(),
        operator_axes=axes,
        done_m=step.within_m,
    )
    return _bound(ruled, motion, None if PLACE & set(axes) else goal)


def _without_way(step: Step) -> Step:
    return msgspec.structs.replace(step, way=None) if isinstance(step, SharedStep) else step


def _request(task: BindTask) -> str:
    return task.data.step.label.removeprefix("OPERATOR: ")


def _bound(
    task: RuledTask, motion: TeleopMotion, goal: list[float] | None, width_m: list[float] | None = None
) -> BoundStep:
    evaluation = EvaluationContext(
        context=task.data.context,
        step=_without_way(task.data.step),
        arm=task.arm,
        goal_pose=goal,
        held=task.held,
        width_m=width_m,
        start_joints=list(task.query.joints(task.arm)),
    )
    return assemble.of_arm(task, motion, evaluation, Expected(task.values["duration_s"]))


def _place(task: BindTask, name: str) -> list[float]:
    """The tcp pose that the step is about; empty: none."""
    if not name:
        return []
    found = targets.binding(task, name)
    if found.joints is None:
        return targets.world_pose(task, found, name)
    pose: list[float] = task.query.model.arms[task.arm].fk(found.joints).tolist()
    return pose


def _hand(task: RuledTask) -> dict[str, Any]:
    """The operator closes the fingers; a grip proves DONE."""
    gripper = task.query.cell.arm(task.arm).gripper
    grip_n = task.data.context.limits.grip_force_n or min(task.values["grip_n"], gripper.max_force_n)
    return {"hand": True, "grip_n": grip_n, "done_grip_n": PRESSES * grip_n}


def _spindle(task: RuledTask, turns: float | None) -> dict[str, Any]:
    """The operator turns the spindle; its turn proves DONE. Positive turns of the step are outwards."""
    driver = task.query.driver(task.arm)
    if driver is None or driver.spindle is None:
        raise Refused.because(RefusalReason.STATE, f"{task.arm} holds no driver", clears="GRASP a driver with it")
    if not turns:
        raise refused_program("the operator's turn needs by_turns", "it in `args` of the step")
    return {
        "spindle": True,
        "spindle_rad_s": min(task.values["spindle_rad_s"], driver.spindle.most_rad_s),
        "spindle_nm": min(task.values["torque_nm"], driver.spindle.most_nm),
        "turn_rad": -math.tau * turns,
    }
