"""The report that is expected of a hand: it closes on the object of its step, or on what it holds. Pure."""

from __future__ import annotations

from rtc.protocol.messages import EndReport, EvaluationContext
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import HandMotion, Primitive
from workers.conditions.prediction import closes_on_m
from workers.planning.world_query import WorldQuery
from workers.tasks.report import at_rest, replaced


def of_hand(query: WorldQuery, made: Primitive, evaluation: EvaluationContext, reason: StopReason) -> EndReport:
    motion, arm = made.trajectory, made.performer
    assert isinstance(motion, HandMotion)
    report = at_rest(query, arm, made.id, reason, query.joints(arm), evaluation.predicted_s)
    if reason is not StopReason.GOAL:
        return report
    between_m = closes_on_m(query, evaluation) if motion.width_m < query.hand_width(arm) else 0.0
    presses = between_m > motion.width_m
    width_m = max(motion.width_m, between_m)
    return replaced(
        report,
        hand_width_m=width_m,
        hand_force_n=motion.force_n if presses else 0.0,
    )
