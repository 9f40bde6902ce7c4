"""A step to be bound: what all parts of the binder share."""

from __future__ import annotations

from dataclasses import dataclass

from rtc.programs.schema import BinderProgram, StopClass
from rtc.protocol.messages import BinderInput
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused
from rtc.protocol.primitive import MAX_S
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
        return str(self.data.step.args.get("arm", "")) or self.data.context.arm

    def stop_class(self, name: str) -> StopClass:
        known = self.program.stop_classes
        if name not in known:
            raise refused_program(f"no stop class {name}", f"there are {', '.join(known)}")
        return known[name]


def refused_program(message: str, clears: str) -> Refused:
    return Refused(Refusal(reason=RefusalReason.PROGRAM, message=message, clears=clears))


def refuse_if_endless(limit_s: float) -> None:
    """Refuse a step whose time limit (s) no primitive can have: a speed near zero, or a time of years."""
    if limit_s <= MAX_S:
        return
    endless = Refusal(
        reason=RefusalReason.INFEASIBLE,
        message=f"this step would need a time limit of {limit_s:.3g} s; {MAX_S:g} s is the longest possible",
        clears="more speed or a greater force, if the sentence limits them; a shorter way or time",
        detail={"cause": "time", "limit_s": MAX_S, "value_s": limit_s},
    )
    raise Refused(endless)
