"""When a finger is felt at the grasp point that its step looks for. Pure."""

from __future__ import annotations

import math

from rtc.protocol.messages import EvaluationContext
from rtc.spatial import geometry
from workers.planning.world_query import WorldQuery
from workers.tasks.report import Course, first_s

CLOSING = 1  # axis of a hand, and of a grasp point, along which the fingers close


def touch_s(query: WorldQuery, arm: str, evaluation: EvaluationContext, course: Course) -> float | None:
    """When the finger towards which the hand moves touches the bar; None if it does not, or touches it already."""
    context = evaluation.context
    if not context.object or not context.grasp_point or evaluation.held:
        return None
    point = query.cell.object(context.object).grasp_point(context.grasp_point)
    bar = geometry.compose(query.frame(context.object), point.frame.pose)
    play_m = 0.5 * (query.hand_width(arm) - point.width_m)  # way of a finger from the middle

    def aside_m(at_s: float) -> float:
        return float(geometry.relative(course.tcp(at_s), bar)[CLOSING])

    side = math.copysign(1.0, aside_m(course.duration_s))

    def touches(at_s: float) -> bool:
        return side * aside_m(at_s) > play_m

    return first_s(course.duration_s, touches) if touches(course.duration_s) and not touches(0.0) else None
