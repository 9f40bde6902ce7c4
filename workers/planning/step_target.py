"""Where a step goes: the same for the elaborator, which tests a plan, and for the binder, which performs it. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from rtc.programs.extension_names import PLAN_AXES, SPACE_ARGS, WAY_OUT
from rtc.protocol.messages import Step
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.planning import axes, curves, suggestions
from workers.planning.segments import Target
from workers.planning.world_query import WorldQuery

HERE = "HERE"  # the pose of the hand when the step begins
Bound = Callable[[str], Target]  # the target that a name stands for. Raises Refused


def target_of(step: Step, query: WorldQuery, arm: str, thing: str, here: Array, bound: Bound) -> Target:
    """The target of a step (world frame): what its name stands for, or the tcp pose `here`, shifted, turned or drawn
    into a curve by its args.

    `thing`: the object of the command, which leaves its seat along WAY-OUT. Raises Refused.
    """
    if step.to != HERE:
        vias = str(step.args.get("through", "")).split()
        return replace(bound(step.to), via=tuple(bound(name) for name in vias))
    axis = axis_of(step)
    if axis not in PLAN_AXES:
        raise suggestions.unknown("axis", axis, PLAN_AXES)
    if step.space in curves.CURVES:
        figures = {name: float(step.args[name]) for name in SPACE_ARGS[step.space] if name in step.args}
        about = hinge_of(step, query, arm, here, bound)
        return Target(poses=curves.curve(step.space, here, about, axis, figures))
    by_m, by_rad = (float(step.args.get(name, 0.0)) for name in ("by_m", "by_rad"))
    if axis == WAY_OUT:
        return Target(pose=geometry.translate(here, by_m * query.leaves_along(thing)).tolist())
    pose = axes.shifted(here, axis, by_m) if by_m else here
    return Target(pose=(axes.turned(pose, axis, by_rad) if by_rad else pose).tolist())


def axis_of(step: Step) -> str:
    return str(step.args.get("axis", "TOOL-Z"))


def about_of(step: Step) -> str:
    """The name of what the step turns about."""
    return str(step.args.get("about", HERE))


def hinge_of(step: Step, query: WorldQuery, arm: str, here: Array, bound: Bound) -> Array:
    """The pose about which the tcp turns (world frame). Raises Refused."""
    name = about_of(step)
    if name == HERE:
        return here
    about = bound(name).pose
    if about is None:
        message = f"{name} is not a pose: nothing turns about joint values"
        raise Refused.because(RefusalReason.PROGRAM, message, clears=f"bind a pose to {name}")
    return query.hinge_of_tcp(arm, here, about, float(step.args.get("hand_turn", 1.0)))
