"""The reports of one primitive while it runs: each period, and each condition once (R of the paper). Pure."""

from __future__ import annotations

import msgspec

from rtc.protocol import messages as m
from rtc.protocol.primitive import Primitive
from rtc.subsystems.base.report_items import STANDARD, Measure, reading
from rtc.subsystems.motion import stop_functions
from rtc.subsystems.motion.arm import TICK_S
from rtc.subsystems.motion.moment import Moment
from rtc.subsystems.motion.observation import Observation


class RunningReports:
    def __init__(
        self,
        performer: str,
        seen: Observation,
        primitive: Primitive,
        conditions: stop_functions.Reports,
        measure: Measure,
    ) -> None:
        self._performer, self._seen, self._primitive, self._measure = performer, seen, primitive, measure
        every_s = primitive.reporting.every_s
        self.period = None if every_s is None else max(1, round(every_s / TICK_S))  # ticks
        self.conditions = conditions  # not reported yet

    def ticks_left(self, ticks: int) -> float:
        """Until the next periodic report is due, after these ticks of the primitive."""
        return float("inf") if self.period is None else self.period - ticks % self.period

    def conditions_met(self, moment: Moment, now_s: float) -> list[m.ProgressReport]:
        """A report for each condition that is true for the first time."""
        met: dict[int, m.ProgressReport] = {}
        for n, check in self.conditions:
            if (finding := check(moment)) is not None and n not in met:
                measured, limit, _ = finding
                progress = self.progress(now_s)
                met[n] = msgspec.structs.replace(progress, condition=n, measured=measured, limit=limit)
        if met:
            self.conditions = [(n, check) for n, check in self.conditions if n not in met]
        return list(met.values())

    def progress(self, now_s: float) -> m.ProgressReport:
        items = self._primitive.reporting.items or STANDARD
        return m.ProgressReport(
            primitive=self._primitive.id,
            at_s=now_s,
            reading=reading(items, self._performer, self._seen, ended=False, measure=self._measure),
        )
