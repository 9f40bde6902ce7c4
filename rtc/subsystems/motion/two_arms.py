"""Two arms in one primitive: both start in the same tick, a stop of one stops the other, one end report. Pure.

Each arm executes its part by itself. This module couples their starts, stops and reports.
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from rtc.protocol import messages as m
from rtc.protocol.outcomes import PRIORITY, Measured, StopReason
from rtc.protocol.primitive import Primitive
from rtc.subsystems.motion.executor import Executor, Reports
from rtc.subsystems.motion.reports import not_begun


class Pairs:
    def __init__(self, executors: Mapping[str, Executor]) -> None:
        self._executors = executors
        self._ends: dict[str, dict[str, m.EndReport | None]] = {}  # primitive -> arm, the leading one first -> its end

    @property
    def exist(self) -> bool:
        return bool(self._ends)

    def begin(self, primitive: Primitive, now_s: float) -> Reports:
        """Start both arms with the next tick, or neither. Both must exist and be free."""
        assert primitive.partner is not None
        part = primitive.partner
        second = Primitive(
            id=primitive.id,
            performer=part.performer,
            trajectory=part.trajectory,
            stop_functions=part.stop_functions,
            control_law=part.control_law,
            hand=part.hand,
        )
        leading, complying = self._executors[primitive.performer], self._executors[part.performer]
        (answer,) = complying.accept(second, now_s)
        if isinstance(answer, m.EndReport):
            pose = leading.arm.tcp_pose(leading.sample.joints)
            why = f"{part.performer}: {answer.message}"
            return [not_begun(primitive.id, leading.name, why, at_s=now_s, sample=leading.sample, tcp_pose=pose)]
        (answer,) = leading.accept(primitive, now_s)
        refused = answer if isinstance(answer, m.EndReport) else None
        self._ends[primitive.id] = {leading.name: refused, complying.name: None}
        if refused is None:
            return [answer]
        complying.halt(refused.reason, refused.message)  # it has not moved; its end completes the report
        return []

    def couple(self) -> None:
        """Stop each arm whose partner has tripped. Call it in every tick."""
        for primitive, ends in self._ends.items():
            arms = [e for e in map(self._executors.__getitem__, ends) if e.primitive_id == primitive]
            cause = next((e for e in arms if e.trip is not None and e.trip.reason is not StopReason.GOAL), None)
            if cause is None or cause.trip is None:
                continue
            for executor in arms:
                if executor.trip is None:
                    executor.halt(cause.trip.reason, f"{cause.name}: {cause.trip.message}".rstrip(": "))

    def whole(self, report: m.EndReport) -> m.EndReport | None:
        """The end report of the whole primitive; None while another part of it has not ended."""
        ends = self._ends.get(report.primitive)
        if ends is None:
            return report
        ends[report.performer] = report
        parts = [end for end in ends.values() if end is not None]
        if len(parts) < len(ends):
            return None
        del self._ends[report.primitive]
        leading, complying = parts
        cause = min(parts, key=lambda end: (PRIORITY[end.reason], end.measured is None))
        return msgspec.structs.replace(
            leading,
            reason=cause.reason,
            message=cause.message,
            measured=cause.measured,
            limit=cause.limit,
            peak_force_n=max(leading.peak_force_n, complying.peak_force_n),
            peak_torque_nm=max(leading.peak_torque_nm, complying.peak_torque_nm),
            partner=complying,
            reading=_of_both(leading.reading, complying.reading),
        )


def _of_both(leading: Measured | None, complying: Measured | None) -> Measured | None:
    """The reading of the leading arm, with that of the other one and the peaks of both."""
    if leading is None or complying is None:
        return leading
    peaks = {
        name: max(getattr(leading, name), getattr(complying, name))
        for name in ("peak_force_n", "peak_torque_nm")
        if getattr(leading, name) is not None
    }
    return msgspec.structs.replace(leading, partner=complying, **peaks)
