"""R of a primitive: what to report beyond the standard end report."""

from __future__ import annotations

from rtc.protocol.primitive.stop_functions import GoalReached, Predicate
from rtc.protocol.strict import Strict


class ReportCondition(Strict, frozen=True, kw_only=True):
    """A condition that is reported and does not stop: once, at the first moment in which it is true."""

    n: int  # number of the condition in the sentence, from 0; several predicates may share it
    when: Predicate

    def __post_init__(self) -> None:
        if isinstance(self.when, GoalReached):
            raise ValueError("the goal is in the end report")


class Reporting(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """R: additions to the standard end report, which always has joints, wrench and reason (R65)."""

    items: list[str] = []  # measured at the end; none: during the motion all standard ones
    every_s: float | None = None  # progress reports at this period
    when: list[ReportCondition] = []  # at most one report for each `n`
