"""The report that is expected of a look: a camera sees the body where it is believed to be, or tells why not. Pure."""

from __future__ import annotations

from rtc.protocol.messages import EndReport, EvaluationContext
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import Look, Primitive
from workers.planning.lines_of_sight import sighting
from workers.planning.world_query import WorldQuery


def of_look(query: WorldQuery, made: Primitive, evaluation: EvaluationContext, reason: StopReason) -> EndReport:
    expected, look = reason in (StopReason.GOAL, StopReason.FOUND), made.trajectory
    assert isinstance(look, Look)
    seen, why = None, ""
    if expected:
        follows = look.duration_s is not None
        seen, why = sighting(query, made.performers, evaluation.body, look.pictures, follows=follows)
    if reason is StopReason.FOUND and seen is None:
        reason = StopReason.NOT_SEEN
    return EndReport(
        primitive=made.id,
        performer=made.performer,
        reason=reason,
        at_s=0.0,
        duration_s=evaluation.predicted_s,
        sighting=seen,
        message=why,
    )
