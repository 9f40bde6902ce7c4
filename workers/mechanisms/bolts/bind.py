"""A turn of the spindle of the held driver: how far, how fast, with which torque; the line of its BACK-OFF. Pure."""

from __future__ import annotations

import math

import msgspec
import numpy as np
from msgspec.structs import replace

from rtc.model.cells import parts
from rtc.protocol.messages import BoundStep, EvaluationContext, TurnStep
from rtc.protocol.outcomes import RefusalReason, Refused, StopReason
from rtc.protocol.primitive import SpindleMotion
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.conditions.prediction import Expected
from workers.planning import segments
from workers.planning.segments import Target
from workers.tasks import assemble
from workers.tasks.bind_task import BindTask, RuledTask, refused_program
from workers.tasks.motion import planning_request

LINE = "move_task"
PROVABLE_TURNS = 0.01  # a smaller turn cannot be proved; what is left after a slip may be less


def bind_spindle(task: BindTask) -> BoundStep:
    """Turn the bolt of the command with the driver in the hand. Raises Refused."""
    step = task.data.step.of_kind(TurnStep)
    ruled, query, bolt = task.under(step.stop), task.query, task.data.context.object
    driver, thread = query.driver(task.arm), query.thread(bolt)
    if driver is None or driver.spindle is None:
        raise Refused.because(RefusalReason.STATE, f"{task.arm} holds no driver", clears="GRASP a driver with it")
    if thread is None:
        raise refused_program(f"{bolt or 'nothing'} has no thread", "a script about an object with a thread")
    values, turns = ruled.values, _turns(task, step, bolt)
    speed_rad_s = min(values["spindle_rad_s"], driver.spindle.most_rad_s)
    motion = SpindleMotion(
        turn_rad=-math.tau * turns, speed_rad_s=speed_rad_s, torque_nm=min(values["torque_nm"], driver.spindle.most_nm)
    )
    here = query.tcp(task.arm)
    out = geometry.rotate(query.frame(bolt), (0.0, 0.0, thread.pitch_m))  # of the bolt, by one turn outwards
    evaluation = EvaluationContext(
        context=task.data.context,
        step=step,
        arm=task.arm,
        goal_pose=geometry.translate(here, turns * out).tolist(),
        held=task.held,
        no_contact_is_failure=StopReason.GOAL not in step.expect,
        start_joints=list(query.joints(task.arm)),
    )
    against = math.copysign(1.0, turns) * _axis(query.grasp(driver.name), driver)
    turn_s = math.tau * abs(turns) / speed_rad_s
    expected = Expected(turn_s, 0.0 if step.expect == [StopReason.GOAL] else turn_s)  # a torque ends it before
    bound = assemble.of_arm(ruled, motion, evaluation, expected, against.tolist())
    return _with_retreat(ruled, bound, turns * out)


def _turns(task: BindTask, step: TurnStep, bolt: str) -> float:
    """The turns that the step states, positive outwards."""
    if step.by_turns is not None:
        return step.by_turns
    assert step.to_turns is not None
    left = step.to_turns - task.query.turns(bolt)
    return math.copysign(max(abs(left), PROVABLE_TURNS), left)


def _axis(grasp: Array | None, driver: parts.Object) -> Array:
    """The axis of the spindle, out of the tool (unit vector, tool axes). A torque on the tool along it opposes a turn
    outwards."""
    assert driver.spindle is not None
    tip = driver.spindle.frame.pose if grasp is None else geometry.compose(grasp, driver.spindle.frame.pose)
    return geometry.rotate(tip, (0.0, 0.0, 1.0))


def _with_retreat(task: RuledTask, bound: BoundStep, travel_m: Array) -> BoundStep:
    """The step with the line along which a BACK-OFF of the sentence retreats: from where the bolt is farther in, past
    where it is farther out. `travel_m`: of the bolt in this step (m, world)."""
    made = bound.primitive
    assert made is not None
    back_m = max((stop.back_off_m for stop in made.stop_functions), default=0.0)
    if back_m <= 0.0:
        return bound
    assert isinstance(made.trajectory, SpindleMotion)
    query, arm = task.query, task.query.model.arms[task.arm]
    here = query.tcp(task.arm)
    back = geometry.rotate(here, (0.0, 0.0, -1.0))
    inner, outer = sorted((here, geometry.translate(here, travel_m)), key=lambda pose: float(pose[:3] @ back))
    begin = arm.nearest_ik(geometry.translate(outer, back_m * back).tolist(), query.joints(task.arm))
    if begin is None:
        raise Refused.because(
            RefusalReason.INFEASIBLE,
            f"{task.arm} cannot back off by {back_m * 1e3:g} mm from {task.data.context.object}",
            where="BACK-OFF",
            clears="a shorter BACK-OFF, or THEN STOP",
        )
    request = planning_request(task, task.values["speed_m_s"], LINE)
    request = replace(request, joints={**request.joints, task.arm: np.asarray(begin, dtype=float)})
    path = segments.plan_segment(request, LINE, Target(pose=inner.tolist())).timed.trajectory()
    turn = msgspec.structs.replace(made.trajectory, retreat=path)
    return msgspec.structs.replace(bound, primitive=msgspec.structs.replace(made, trajectory=turn))
