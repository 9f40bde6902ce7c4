"""Where a step goes: the same for the elaborator, which tests a plan, and for the binder, which performs it. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
from msgspec.structs import replace

from rtc.programs.extension_names import PLAN_AXES, WAY_OUT
from rtc.protocol.messages import ArmStep, BaseStep, CircleStep, MoveStep, PathStep, PatternStep, SharedStep, Step
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.planning import axes, curves, suggestions
from workers.planning.segments import Target
from workers.planning.world_query import WorldQuery

TURN = "turn_rad"  # figure of a stop class: the turn at which the step ends
HERE = "HERE"  # the pose of the hand when the step begins
Bound = Callable[[str], Target]  # the target that a name stands for. Raises Refused


def target_of(step: PathStep, query: WorldQuery, arm: str, thing: str, here: Array, bound: Bound) -> Target:
    """The target of a step (world frame): what its name stands for, or the tcp pose `here`, shifted, turned or drawn
    into a curve by its args.

    `thing`: the object of the command, which leaves its seat along WAY-OUT. Raises Refused.
    """
    if isinstance(step, MoveStep | SharedStep) and step.to != HERE:
        around = isinstance(step, MoveStep) and bool(step.around)
        return replace(bound(step.to), via=tuple(map(bound, step.through)), around=around)
    axis = axis_of(step)
    if axis not in PLAN_AXES:
        raise suggestions.unknown("axis", axis, PLAN_AXES)
    if isinstance(step, CircleStep):
        return Target(poses=curves.circle(step, here, hinge_of(step, query, arm, here, bound), axis))
    if isinstance(step, PatternStep):
        return Target(poses=curves.pattern(step, here, axis))
    by_m, by_rad = (step.by_m, step.by_rad) if isinstance(step, MoveStep) else (0.0, 0.0)
    if axis == WAY_OUT:
        return Target(pose=geometry.translate(here, by_m * query.leaves_along(thing)).tolist())
    pose = axes.shifted(here, axis, by_m) if by_m else here
    return Target(pose=(axes.turned(pose, axis, by_rad) if by_rad else pose).tolist())


def counted_from_now(step: Step, query: WorldQuery, thing: str) -> Step:
    """The step with its turn counted from the angle that the object has now: a step that is tried again ends where it
    would have ended the first time."""
    if not isinstance(step, CircleStep) or step.from_rad is None:
        return step
    gone_rad = query.angle(thing) - step.from_rad
    overrides = dict(step.overrides)
    if TURN in overrides:
        overrides[TURN] = max(0.0, overrides[TURN] - math.copysign(gone_rad, gone_rad * step.by_rad))
    return msgspec.structs.replace(step, by_rad=step.by_rad - gone_rad, from_rad=None, overrides=overrides)


def axis_of(step: BaseStep) -> str:
    return (step.axis if isinstance(step, ArmStep) else "") or "TOOL-Z"


def hinge_of(step: CircleStep, query: WorldQuery, arm: str, here: Array, bound: Bound) -> Array:
    """The pose about which the tcp turns (world frame). Raises Refused."""
    if step.about == HERE:
        return here
    about = bound(step.about).pose
    if about is None:
        message = f"{step.about} is not a pose: nothing turns about joint values"
        raise Refused.because(RefusalReason.PROGRAM, message, clears=f"bind a pose to {step.about}")
    return query.hinge_of_tcp(arm, here, about, step.hand_turn)
