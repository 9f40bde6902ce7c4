"""Whether an arm may move alone: not while another arm holds the same object. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from rtc.language.hands import hand_in_words
from rtc.protocol.outcomes import Refusal, RefusalReason
from workers.planning.world_query import WorldQuery


def refuse_alone(query: WorldQuery, arm: str, partner: str, clears: Mapping[str, str]) -> Refusal | None:
    """Refuse a motion of one arm whose object another arm holds too; None if no other arm does."""
    sharing = query.sharers(arm)
    if partner or not sharing:
        return None
    held = query.holding(arm)
    return Refusal(
        reason=RefusalReason.STATE,
        message=f"{arm} cannot move alone: {sharing[0]} holds {held} too",
        clears=clears.get("shared", "").replace("{held}", held).replace("{other}", hand_in_words(sharing[0])),
    )
