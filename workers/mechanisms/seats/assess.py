"""What follows for seats, and for what is in them, if the frame of one of them is stated. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rtc.protocol.causes import NeedUnmet
from rtc.protocol.messages import WorldChange
from rtc.protocol.outcomes import RefusalReason, Refused
from workers.planning.world_query import WorldQuery
from workers.tasks import seated


def placed(thing: str, frame: Any, query: WorldQuery, values: Mapping[str, float]) -> list[WorldChange]:
    """The frames of what is in a seat, or the seat of an object that is in no hand. Raises Refused if it is taken."""
    if query.is_seat(thing):
        return seated.content(query, thing, frame)
    if query.held_by(thing):
        return []
    seat = seated.seat_at(frame, query, values["seated_m"], values["seated_rad"])
    others = [name for name in query.inside(seat) if name != thing]
    if others:
        raise Refused.because(
            RefusalReason.INFEASIBLE,
            f"{thing}.frame is in {seat}, where {others[0]} is believed to be",
            where=f"{thing}.frame",
            clears=f"first state where {others[0]} is",
            cause=NeedUnmet(need="seat_free", by=others[0]),
        )
    return [WorldChange(key=f"{thing}.seat", value=seat), WorldChange(key=f"{thing}.grasp", value=None)]
