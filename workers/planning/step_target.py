"""Where a step goes: the same for the elaborator, which tests a plan, and for the binder, which performs it. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
from msgspec.structs import replace

from rtc.programs.extension_names import PLAN_AXES, SPACE_ARGS, WAY_OUT
from rtc.protocol.messages import Step
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.planning import axes, curves, suggestions
from workers.planning.segments import Target
from workers.planning.world_query import WorldQuery

TURN = "turn_rad"  # figure of a stop class: the turn at which the step ends
HERE = "HERE"  # the pose of the hand when the step begins
Bound = Callable[[str], Target]  # the target that a name stands for. Raises Refused


def target_of(step: Step, query: WorldQuery, arm: str, thing: str, here: Array, bound: Bound) -> Target:
    """The target of a step (world frame): what its name stands for, or the tcp pose `here`, shifted, turned or drawn
    into a curve by its args.

    `thing`: the object of the command, which leaves its seat along WAY-OUT. Raises Refused.
    """
    if step.to != HERE:
        target, through = bound(step.to), step.words.through
        return replace(target, via=tuple(map(bound, through)), around=bool(step.words.around))
    axis = axis_of(step)
    if axis not in PLAN_AXES:
        raise suggestions.unknown("axis", axis, PLAN_AXES)
    if step.space in curves.CURVES:
        figures = {name: value for name, value in step.figures.given().items() if name in SPACE_ARGS[step.space]}
        about = hinge_of(step, query, arm, here, bound)
        return Target(poses=curves.curve(step.space, here, about, axis, figures))
    by_m, by_rad = step.figures.by_m or 0.0, step.figures.by_rad or 0.0
    if axis == WAY_OUT:
        return Target(pose=geometry.translate(here, by_m * query.leaves_along(thing)).tolist())
    pose = axes.shifted(here, axis, by_m) if by_m else here
    return Target(pose=(axes.turned(pose, axis, by_rad) if by_rad else pose).tolist())


def counted_from_now(step: Step, query: WorldQuery, thing: str) -> Step:
    """The step with its turn counted from the angle that the object has now: a step that is tried again ends where it
    would have ended the first time."""
    from_rad, by_rad = step.figures.from_rad, step.figures.by_rad
    if from_rad is None or by_rad is None:
        return step
    gone_rad = query.angle(thing) - from_rad
    figures = msgspec.structs.replace(step.figures, by_rad=by_rad - gone_rad, from_rad=None)
    overrides = dict(step.overrides)
    if TURN in overrides:
        overrides[TURN] = max(0.0, overrides[TURN] - math.copysign(gone_rad, gone_rad * by_rad))
    return msgspec.structs.replace(step, figures=figures, overrides=overrides)


def axis_of(step: Step) -> str:
    return step.words.axis or "TOOL-Z"


def hinge_of(step: Step, query: WorldQuery, arm: str, here: Array, bound: Bound) -> Array:
    """The pose about which the tcp turns (world frame). Raises Refused."""
    name = step.words.about
    if name == HERE:
        return here
    about = bound(name).pose
    if about is None:
        message = f"{name} is not a pose: nothing turns about joint values"
        raise Refused.because(RefusalReason.PROGRAM, message, clears=f"bind a pose to {name}")
    return query.hinge_of_tcp(arm, here, about, 1.0 if step.figures.hand_turn is None else step.figures.hand_turn)
