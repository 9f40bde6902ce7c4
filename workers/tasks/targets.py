"""Where a step goes: its target, its line or curve, and the direction of a force against it."""

from __future__ import annotations

import math
from functools import partial

from rtc.programs.extension_names import WAY_OUT
from rtc.protocol.messages import ArmStep, Binding, CircleStep, PathStep
from rtc.protocol.outcomes import Refused, refuse_if
from rtc.protocol.primitive import Vector
from rtc.protocol.primitive_id import command_of
from rtc.spatial import geometry
from workers.conditions import stop_conditions
from workers.planning import axes, step_target, suggestions, trust
from workers.planning.motion.plan import Motion
from workers.planning.segments import Target
from workers.tasks import replan
from workers.tasks.bind_task import BindTask, refused_program, unknown_in_program

MIN_STEP_M = 0.001  # minimum length of a line with a defined direction
MAX_TURN_RAD = math.radians(5.0)  # maximum rotation along a line with a constant direction in the tool frame


def target_of(task: BindTask, step: PathStep) -> Target:
    """The target of the step in the current world. Raises Refused."""
    here = task.query.tcp(task.arm)
    return step_target.target_of(step, task.query, task.arm, task.data.context.object, here, partial(_bound, task))


def _bound(task: BindTask, name: str) -> Target:
    """The target that a binding stands for."""
    found = binding(task, name)
    return Target(pose=world_pose(task, found, name)) if found.joints is None else Target(joints=found.joints)


def binding(task: BindTask, name: str) -> Binding:
    known = task.data.bindings
    if name not in known:
        raise unknown_in_program("binding", name, known)
    return known[name]


def world_pose(task: BindTask, binding: Binding, name: str) -> list[float]:
    """A pose binding in the world frame. Refuses a binding relative to a body whose frame is not trusted (R151)."""
    if binding.pose is None:
        raise refused_program(f"{name} is not a pose", "bind a pose or joint values to it")
    query = task.query
    if binding.frame is not None:
        known = [one.name for bodies in (query.cell.objects, query.cell.seats) for one in bodies]
        if binding.frame not in known:
            raise suggestions.unknown("object or seat", binding.frame, known)
        command = command_of(task.data.primitive_id)
        refuse_if(trust.distrusted(query, f"{binding.frame}.frame", task.program.clears, own=command))
    pose: list[float] = replan.current_pose(query, task.arm, binding).tolist()
    return pose


def against_motion(start: list[float], motion: Motion) -> Vector | None:
    """Unit vector (tool frame) of a force that opposes this line; None if it is not constant along the line."""
    if (
        geometry.distance(start, motion.goal_pose) < MIN_STEP_M
        or geometry.angle(start, motion.goal_pose) > MAX_TURN_RAD
    ):
        return None
    way = motion.goal_pose[:3] - start[:3]
    axis: Vector = (
        -geometry.rotate(geometry.inverse(start), way / math.dist(motion.goal_pose[:3], start[:3]))
    ).tolist()
    return axis


def turn_line(task: BindTask) -> stop_conditions.TurnLine:
    """The line about which the step turns; of a step without an axis any change of attitude counts."""
    step, here, axis = task.data.step, task.query.tcp(task.arm), step_target.axis_of(task.data.step)
    if not isinstance(step, CircleStep) or step.about == step_target.HERE:
        named = isinstance(step, ArmStep) and step.axis not in ("", WAY_OUT)
        return stop_conditions.TurnLine(axes.direction(here, axis) if named else None, None)
    try:
        about = step_target.hinge_of(step, task.query, task.arm, here, partial(_bound, task))
    except Refused:  # `target_of` has refused it already
        return stop_conditions.TurnLine(None, None)
    return stop_conditions.TurnLine(axes.direction(about, axis), about[:3].tolist())
