"""How a way that a door blocks is cleared: the door is turned to its other side. Pure."""

from __future__ import annotations

import math

from rtc.protocol.advice import Texts
from rtc.protocol.outcomes import Refusal
from workers.planning.world_query import WorldQuery

SHARE_OF_RANGE = 0.9  # of a hinge, that advised sentences use


def way(refusal: Refusal, query: WorldQuery, arm: str, body: str) -> str:
    """The row for a door that is at the goal or beside the arm, or that this arm turns; empty for other bodies."""
    if query.hinge(body) is None:
        return ""
    if query.held_by(body) == arm:
        return "way_turned"
    beside = refusal.fraction < 0.5 and not query.holding(arm)
    return "way_beside_hinged" if beside else "way_hinged"


def about(query: WorldQuery, body: str) -> Texts:
    """{turn}: the sentence that turns a door to its other side, short of the stop; {angle}: where it is (deg)."""
    hinge = query.hinge(body)
    if hinge is None:
        return {"turn": "", "angle": "0"}
    angle_deg, (closed_deg, open_deg) = math.degrees(query.angle(body)), hinge.range_deg
    opened = angle_deg > 0.5 * (closed_deg + open_deg)
    turn = f"CLOSE {body}" if opened else f"OPEN {body} TO {SHARE_OF_RANGE * open_deg:.0f} DEG"
    return {"turn": turn, "angle": f"{angle_deg:.0f}"}
