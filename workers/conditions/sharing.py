"""Whether an arm may move alone: not while another arm holds the same object. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from rtc.language.hands import hand_in_words
from rtc.protocol import causes
from rtc.protocol.advice import Advice, fill_in
from rtc.protocol.messages import ScriptContext
from rtc.protocol.outcomes import RefusalReason, Refused
from workers.planning.world_query import WorldQuery


def refuse_alone(query: WorldQuery, arm: str, partner: str, clears: Mapping[str, Advice]) -> None:
    """Refuse a motion of one arm whose object another arm holds too."""
    sharing = query.sharers(arm)
    if partner or not sharing:
        return
    held = query.holding(arm)
    message = f"{arm} cannot move alone: {sharing[0]} holds {held} too"
    advice = fill_in(clears.get("shared", []), {"held": held, "other": hand_in_words(sharing[0])})
    cause = causes.NeedUnmet(need="shared", by=sharing[0])
    raise Refused.because(RefusalReason.STATE, message, clears=advice, cause=cause)


def offer(query: WorldQuery, context: ScriptContext) -> str:
    """The sentence that asks the operator instead; empty while another arm holds the same object."""
    return "" if query.sharers(context.arm) else context.by_operator
