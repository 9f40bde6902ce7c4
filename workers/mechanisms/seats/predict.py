"""When a held object is felt in its seat. Pure."""

from __future__ import annotations

from rtc.protocol.messages import EvaluationContext
from rtc.spatial import geometry
from workers.planning.world_query import WorldQuery
from workers.tasks.report import HALVINGS, Course


def touch_s(query: WorldQuery, arm: str, evaluation: EvaluationContext, course: Course) -> float | None:
    """When a held object is nearest to its place in the seat, by thirds: it comes, or leaves. None of other steps."""
    held, seat = evaluation.held, evaluation.context.target
    if not held or not query.is_seat(seat):
        return None
    place = query.seated_pose(seat)

    def off_m(at_s: float) -> float:
        frame = query.in_hand(held, course.tcp(at_s))
        return geometry.distance(frame, place) if frame is not None else 0.0

    before_s, after_s = 0.0, course.duration_s
    for _ in range(HALVINGS):
        third_s = (after_s - before_s) / 3.0
        nearer = off_m(before_s + third_s) <= off_m(after_s - third_s)
        before_s, after_s = (before_s, after_s - third_s) if nearer else (before_s + third_s, after_s)
    return before_s
