"""Whether what a hand holds is known well enough for a step: asked when a script is made, and when its step is bound.

A step says what it needs in its args: `needs_m` and `needs_rad`, the same along and about all axes; or `needs`, a seat
whose own figures (`needs_within` of the cell) count. Time and blows make what is held known less, so both ask. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from rtc.outcomes import Refusal, RefusalReason
from rtc.world.spread import Spread, even, exceeded
from workers.belief import WorldQuery

Args = Mapping[str, float | str]


def refuse_if_uncertain(query: WorldQuery, arm: str, args: Args, clears: Mapping[str, str]) -> Refusal | None:
    """Why the step cannot be done with what the arm holds; None when it can, or when it holds nothing."""
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
        message=f"how {arm} holds {held} is known too badly for this: {', '.join(axes)}",
        where=key,
        clears=clears.get("spread", "sense {location} again").replace("{location}", held),
        detail={"cause": "spread", "axes": ", ".join(axes)},
    )


def needed(query: WorldQuery, args: Args) -> Spread | None:
    """The bounds that a step needs; None when it needs none."""
    seat = args.get("needs")
    if isinstance(seat, str) and seat:
        within = query.cell.seat(seat).needs_within
        return within.spread if within is not None else None
    metres, radians = (args.get(name) for name in ("needs_m", "needs_rad"))
    if not isinstance(metres, float) and not isinstance(radians, float):
        return None
    return even(*(n if isinstance(n, float) else math.inf for n in (metres, radians)))
