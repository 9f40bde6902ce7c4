"""A step to be bound: what all parts of the binder share."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import msgspec

from rtc.programs.schema import BinderProgram, StopClass
from rtc.protocol.causes import UnknownName
from rtc.protocol.messages import BinderInput, Limits
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.spelling import unknown
from workers.conditions import stop_conditions
from workers.conditions.stop_conditions import Values
from workers.planning.world_query import WorldQuery


@dataclass(frozen=True)
class BindTask:
    """One step to be bound."""

    program: BinderProgram
    query: WorldQuery
    data: BinderInput

    @property
    def arm(self) -> str:
        """The arm that performs the step: that of the command, or another one whose joints it reads first."""
        return self.data.step.arm or self.data.context.arm

    @property
    def limits(self) -> Limits:
        """The limits of the command for this arm: only its first hand keeps an attitude."""
        limits = self.data.context.limits
        return limits if self.arm == self.data.context.arm else msgspec.structs.replace(limits, attitude=None)

    @property
    def held(self) -> str:
        """The object in the hand; empty: none."""
        return self.query.holding(self.arm)

    @property
    def time_left_s(self) -> float | None:
        """The time that the motions of the command have left of its TIME-LIMIT; None without one."""
        most_s = self.data.context.limits.time_s
        return None if most_s is None else most_s - self.data.moved_s

    def under(self, name: str) -> RuledTask:
        """The step under this stop class. Raises Refused, and ExpressionError for a figure that is not defined."""
        known = self.program.stop_classes
        if name not in known:
            raise unknown_in_program("stop class", name, known)
        values = stop_conditions.figures_in_force(self.program, known[name], self.query, self.data, self.arm)
        return RuledTask(self.program, self.query, self.data, known[name], values)


@dataclass(frozen=True)
class RuledTask(BindTask):
    """One step with its stop class, and the figures in force."""

    stop_class: StopClass
    values: Values


def unknown_in_program(kind: str, name: str, known: Iterable[str]) -> Refused:
    cause = UnknownName(what=kind, name=name)
    return refused_program(unknown(kind, name, known), "LOAD a program that has it", cause)


def refused_program(message: str, clears: str, cause: UnknownName | None = None) -> Refused:
    return Refused.because(RefusalReason.PROGRAM, message, clears=clears, cause=cause)
