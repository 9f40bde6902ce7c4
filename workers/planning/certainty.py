"""Required certainty of a held object's pose for a step. Pure.

A step states the requirement in its args: `needs_m` and `needs_rad` for all axes, or `needs`, a seat with its own
bounds (`needs_within` in the cell). The elaborator and the binder both check it, because uncertainty grows with time
and with impacts. The elaborator adds the time of the motions before the step, so that an accepted command can end.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from rtc.protocol.messages import Limits
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.world.spread import Spread, even, exceeded
from workers.planning import trust
from workers.planning.world_query import WorldQuery

Args = Mapping[str, float | str]


#: time that the elaborator allows for a motion at the cell's speed; a carry across the default cell takes 9 s
MOTION_S = 15.0


def motion_time_s(query: WorldQuery, limits: Limits) -> float:
    """Time allowed for one motion, in proportion to the speed stated in the command."""
    free_m_s = query.cell.numbers.free_speed_m_s
    speed_m_s = min(limits.speed_m_s or free_m_s, free_m_s * (limits.speed_ratio or 1.0))
    return MOTION_S * max(1.0, free_m_s / speed_m_s)


def why_uncertain(
    query: WorldQuery, arm: str, args: Args, clears: Mapping[str, str], ahead_s: float = 0.0
) -> Refusal | None:
    """The refusal of a step for which the grasp of the held object is too uncertain; None: certain, or an empty hand.

    `ahead_s`: when the step begins, after the time of the query.
    """
    held = query.holding(arm)
    within = needed(query, args) if held else None
    if within is None:
        return None
    key = f"{held}.grasp"
    axes = exceeded(trust.grasp_spread(query, held, ahead_s), within)
    if not axes:
        return None
    return Refusal(
        reason=RefusalReason.SUSPECT,
        message=f"the grasp of {held} by {arm} is too uncertain for this: {', '.join(axes)}",
        where=key,
        clears=trust.narrows(query, key, clears),
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
