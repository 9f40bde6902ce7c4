"""The force that is expected on the way of a plug into its socket. Pure."""

from __future__ import annotations

from rtc.protocol.messages import EndReport, EvaluationContext
from workers.planning.world_query import WorldQuery
from workers.tasks.report import replaced


def through_the_latch(query: WorldQuery, evaluation: EvaluationContext, report: EndReport) -> EndReport:
    """The peak is that of the latch before it clicks."""
    target = evaluation.context.target
    mating = query.cell.seat(target).mating if target else None
    return report if mating is None else replaced(report, peak_force_n=mating.most_n)
