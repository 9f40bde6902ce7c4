"""A held object that is still in the slot of a seat leaves it straight along the way out, or not at all. Pure.

The play in a seat is smaller than the uncertainty of a pose in the hand. So a collision check cannot show that another
path out is free.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from rtc.language.hands import hand_in_words
from rtc.protocol import causes
from rtc.protocol.advice import Advice, by_sentence, fill_in
from rtc.protocol.messages import PathStep
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial import geometry
from rtc.spatial.geometry import Floats
from workers.planning.world_query import WorldQuery

SPARE_M = 0.03  # of the advised way beyond the depth of the seat
ASIDE_M, TURNED_RAD = 0.003, math.radians(1.0)  # maximum deviation of a line from the way out


def refuse_other_way(
    query: WorldQuery, arm: str, step: PathStep, tcp: Floats, goal: Floats | None, clears: Mapping[str, Advice]
) -> None:
    """Refuse a motion that starts with the held object in a slot, and that does not follow the way out, or leads
    deeper than the object's place in the seat.

    `goal`: the tcp pose at its end, if it is a line. Straight lines of one arm are left to the collision check and to
    their stop class, but for those that should leave the seat: they may touch it. `tcp`, `goal`: world frame.
    """
    held, leaves = query.holding(arm), step.leaves_seat
    frame = query.in_hand(held, tcp) if held and (leaves or step.space in ("move_joint", "move_both")) else None
    seat = query.slot_at(frame) if frame is not None and query.hinge(held) is None else ""
    if not seat or frame is None:
        return
    goal = None if step.space == "move_joint" else goal
    deeper = goal is not None and _deeper(query, seat, frame, np.asarray(goal[:3]) - np.asarray(tcp[:3]))
    if goal is not None and not deeper and (leaves or _follows(query, seat, tcp, goal)):
        return
    way = "goes no deeper into it" if deeper else "leaves it only in a straight line"
    lift = way_out_in_words(query, arm, seat, frame)
    raise Refused.because(
        RefusalReason.STATE,
        f"{held} is in {seat}, and {way}",
        where=held,
        clears=fill_in(clears.get("way_seated", by_sentence(lift)), {"lift": lift, "held": held, "seat": seat}),
        cause=causes.InSeat(arm=arm, seat=seat),
    )


def way_out_in_words(query: WorldQuery, arm: str, seat: str, frame: Floats | None = None, thing: str = "") -> str:
    """The sentence that takes the held object out of this seat. `frame`: of the object; None: as believed. `thing`: it,
    if no arm holds it yet."""
    held = thing or query.holding(arm)
    left_m = query.cell.seat(seat).depth_m + SPARE_M - query.out_m(seat, query.frame(held) if frame is None else frame)
    by = f"BY {max(1, math.ceil(100 * left_m - 0.05))} CM"
    if thing:
        return f"LIFT {thing} {by}"
    if query.sharers(arm):
        return f"MOVE BOTH-ARMS {by} ALONG {query.way_out_of(seat)}"
    return f"LIFT {held} {by} WITH {hand_in_words(arm)}"


def remark_on_slot(query: WorldQuery, arm: str, tcp: Floats) -> str:
    """How the held object gets free of the slot that it is still in when the hand is at `tcp` (world frame); empty if
    it is in none."""
    held = query.holding(arm)
    frame = query.in_hand(held, tcp) if held else None
    seat = query.slot_at(frame) if frame is not None and query.hinge(held) is None else ""
    if not seat:
        return ""
    return f"{held} is still in the slot of {seat}; free of it after: {way_out_in_words(query, arm, seat, frame)}"


def _follows(query: WorldQuery, seat: str, tcp: Floats, goal: Floats) -> bool:
    """Whether a line of the hand is parallel to the way out."""
    out = query.out_of(seat)
    way = np.asarray(goal[:3]) - np.asarray(tcp[:3])
    aside_m = float(np.linalg.norm(way - float(way @ out) * out))
    return aside_m <= ASIDE_M and geometry.angle(tcp, goal) <= TURNED_RAD


def _deeper(query: WorldQuery, seat: str, frame: Floats, by: Floats) -> bool:
    """Whether an object at `frame` that moves `by` (m, world) ends deeper than its place in the seat, and than now."""
    now_m = query.out_m(seat, frame)
    return now_m + float(np.asarray(by) @ query.out_of(seat)) < min(0.0, now_m)
