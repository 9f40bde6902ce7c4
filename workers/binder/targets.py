"""Where a step goes: its target, its line or curve, and the direction of a force against it."""

from __future__ import annotations

import math
from dataclasses import replace

from rtc.programs.extension_names import SPACE_ARGS, WAY_OUT
from rtc.protocol.messages import Binding
from rtc.protocol.outcomes import Refused, refuse_if
from rtc.protocol.primitive import Vector
from rtc.protocol.primitive_id import command_of
from rtc.spatial import geometry
from rtc.spatial.axis_names import AXES
from workers.binder import replan
from workers.binder.bind_task import BindTask, refused_program
from workers.conditions import stop_conditions
from workers.planning import axes, curves, suggestions
from workers.planning.motion.plan import Motion
from workers.planning.segments import Target

MIN_STEP_M = 0.001  # minimum length of a line with a defined direction
MAX_TURN_RAD = math.radians(5.0)  # maximum rotation along a line with a constant direction in the tool frame


def target_of(task: BindTask) -> Target:
    """The target of the step (world frame): a binding or the tcp pose, shifted and turned by the step's args.

    Raises Refused."""
    step = task.data.step
    if step.to == "HERE":
        pose = task.query.tcp(task.arm).tolist()
    else:
        goal = _bound_target(task, step.to)
        return replace(goal, via=tuple(_bound_target(task, name) for name in str(step.args.get("through", "")).split()))
    axis = str(step.args.get("axis", "TOOL-Z"))
    if axis == WAY_OUT:
        out = task.query.leaves_along(task.data.context.object)
        return Target(pose=geometry.translate(pose, float(step.args.get("by_m", 0.0)) * out).tolist())
    if axis not in AXES:
        raise suggestions.unknown("axis", axis, AXES)
    if step.space in curves.CURVES:
        return _curve_of(task, pose, axis)
    by_m, by_rad = (float(step.args.get(name, 0.0)) for name in ("by_m", "by_rad"))
    if by_m:
        pose = axes.shifted(pose, axis, by_m).tolist()
    if by_rad:
        pose = axes.turned(pose, axis, by_rad).tolist()
    return Target(pose=pose)


def _bound_target(task: BindTask, name: str) -> Target:
    """The target that a binding stands for."""
    found = binding(task, name)
    return Target(pose=world_pose(task, found, name)) if found.joints is None else Target(joints=found.joints)


def binding(task: BindTask, name: str) -> Binding:
    known = task.data.bindings
    if name not in known:
        raise refused_program(f"nothing binds {name}", f"there are {', '.join(known)}")
    return known[name]


def _curve_of(task: BindTask, start: list[float], axis: str) -> Target:
    step, about = task.data.step, start
    if (name := str(step.args.get("about", "HERE"))) != "HERE":
        found = world_pose(task, binding(task, name), name)
        about = task.query.hinge_of_tcp(task.arm, start, found, _hand_turn(task)).tolist()
    figures = {name: float(step.args[name]) for name in SPACE_ARGS[step.space] if name in step.args}
    return Target(poses=curves.curve(step.space, start, about, axis, figures))


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
        refuse_if(query.distrusted(f"{binding.frame}.frame", task.program.clears, own=command))
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


def turn_line(task: BindTask) -> stop_conditions.Line:
    """The line about which the step turns; of a step without an axis any change of attitude counts."""
    step, query = task.data.step, task.query
    axis, name = step.args.get("axis"), str(step.args.get("about", "HERE"))
    if (not isinstance(axis, str) or axis == WAY_OUT) and name == "HERE":
        return stop_conditions.Line(None, None)
    here = query.tcp(task.arm)
    try:
        found = world_pose(task, task.data.bindings[name], name) if name in task.data.bindings else here.tolist()
    except Refused:  # `target_of` has refused it already
        return stop_conditions.Line(None, None)
    along = axes.direction(found, str(axis or "TOOL-Z"))
    if name == "HERE":
        return stop_conditions.Line(along, None)
    return stop_conditions.Line(along, query.hinge_of_tcp(task.arm, here, found, _hand_turn(task))[:3].tolist())


def _hand_turn(task: BindTask) -> float:
    return float(task.data.step.args.get("hand_turn", 1.0))
