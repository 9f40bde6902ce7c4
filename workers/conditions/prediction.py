"""How long a primitive is expected to take, and within which band. Pure.

The binder writes the result into the evaluation context. A rehearsal reports it, and the analyzer compares it with the
measured duration. Figures are those of the binder's program (`settle_s`, `touch_s` ...), measured in physics.
"""

from __future__ import annotations

from typing import NamedTuple

from rtc.protocol.messages import BaseStep, EvaluationContext, MoveStep
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import HandMotion
from workers.conditions.stop_conditions import Values
from workers.planning.world_query import WorldQuery


class Expected(NamedTuple):
    """A duration (s), and half the width of the band in which it should be."""

    seconds: float
    within_s: float = 0.0


def of_path(values: Values, step: BaseStep, path_s: float, *, speed_m_s: float, laden: bool) -> Expected:
    """Of a motion along a path of `path_s`. One that should end with a touch ends `beyond_m` before the end of its
    path, or after `touch_s` if it begins in contact; it may end earlier or later by as much. On a shorter path than
    `blend_s` it may last so long: an offset of the arm from its path takes that time to fade out."""
    whole_s = path_s + values["settle_s"] + (values["laden_settle_s"] if laden else 0.0)
    if StopReason.CONTACT not in step.expect:
        return Expected(whole_s, max(0.0, values["blend_s"] - whole_s))
    if StopReason.GOAL in step.expect:  # a touch is possible, but not foreseen
        return Expected(whole_s, whole_s)
    if (touch_s := values.get("touch_s")) is not None:
        return Expected(min(touch_s, path_s), touch_s)
    before_s = (step.beyond_m if isinstance(step, MoveStep) else 0.0) / speed_m_s
    return Expected(max(0.0, path_s - before_s) + values["unload_s"], before_s)


def of_hand(query: WorldQuery, values: Values, evaluation: EvaluationContext, motion: HandMotion) -> Expected:
    """Of a hand that opens or closes. It takes `force_s_n` seconds a newton to build its force up, and to take the one
    with which it grips now away. Fingers that grip already have their spring stretched: only its limit rises."""
    arm = evaluation.arm
    width_m, between_m, now_n = query.hand_width(arm), closes_on_m(query, evaluation), query.hand_force(arm)
    if motion.width_m < width_m:
        force_n = motion.force_n if between_m > motion.width_m and now_n == 0.0 else 0.0
        more_s = values["force_s_n"] * force_n
    else:
        more_s = values["free_s"] + values["force_s_n"] * now_n if now_n > 0.0 else 0.0
    ends_m = max(motion.width_m, between_m) if motion.width_m < width_m else motion.width_m
    travel_s = abs(width_m - ends_m) / motion.speed_m_s
    return Expected(travel_s + more_s + values["hand_settle_s"], values["hand_within_s"])


def closes_on_m(query: WorldQuery, evaluation: EvaluationContext) -> float:
    """Width of what the hand of a step closes on: what it holds, else the grasp point of the step; 0 if nothing."""
    context = evaluation.context
    if evaluation.held:
        return query.hand_width(evaluation.arm)
    if context.object and context.grasp_point:
        return query.cell.object(context.object).grasp_point(context.grasp_point).width_m
    return 0.0
