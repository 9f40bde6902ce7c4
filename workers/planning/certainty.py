"""Required certainty of a held object's pose for a step. Pure.

A step states the requirement in its args: `needs_m` and `needs_rad` for all axes, or `needs`, a seat with its own
bounds (`needs_within` in the cell). The elaborator and the binder both check it, because uncertainty grows with time
and with impacts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.world.spread import Spread, even, exceeded
from workers.planning.world_query import WorldQuery

Args = Mapping[str, float | str]


def refuse_if_uncertain(query: WorldQuery, arm: str, args: Args, clears: Mapping[str, str]) -> Refusal | None:
    """Refuse a step if the held object's grasp is too uncertain; None if it is not, or if the hand is empty."""
    held = query.holding(arm)
    within = needed(query, args) if held else None
    if within is None:
        return None
    key = f"{held}.grasp"
    axes = exceeded(query.spread(key), within)
    if not axes:
        return None
    return Refusal(
        reason=RefusalReason.SUSPECT,
        message=f"the grasp of {held} by {arm} is too uncertain for this: {', '.join(axes)}",
        where=key,
        clears=clears.get("spread", "sense {location} again").replace("{location}", held),
        detail={"cause": "spread", "axes": ", ".join(axes)},
    )


def needed(query: WorldQuery, args: Args) -> Spread | None:
    """The maximum spread that a step accepts; None if it has no requirement."""
    seat = args.get("needs")
    if isinstance(seat, str) and seat:
        within = query.cell.seat(seat).needs_within
        return within.spread if within is not None else None
    metres, radians = (args.get(name) for name in ("needs_m", "needs_rad"))
    if not isinstance(metres, float) and not isinstance(radians, float):
        return None
    return even(*(n if isinstance(n, float) else math.inf for n in (metres, radians)))
