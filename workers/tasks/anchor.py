"""Anchor of a plan: joint values or a tcp pose, which an elaborator's step leads to."""

from __future__ import annotations

import msgspec

from rtc.protocol.advice import Advice
from rtc.protocol.outcomes import RefusalReason, Refused


class Anchor(msgspec.Struct, frozen=True):
    """Joint values (rad), or a tcp pose in `frame` (an object or seat; None = world). `grasp`: pose of the held object
    in the hand that it was made for; with another one the tcp must go elsewhere. `relies_on`: keys of the facts used.
    """

    joints: list[float] | None = None
    pose: list[float] | None = None
    frame: str | None = None
    grasp: list[float] | None = None
    relies_on: tuple[str, ...] = ()


def refused(message: str, clears: str | Advice) -> Refused:
    """The refusal of an anchor that does not exist in this state of the world."""
    return Refused.because(RefusalReason.STATE, message, clears=clears)
