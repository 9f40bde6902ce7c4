"""Whether a plug is mated, and with which socket, as far as is known. Pure."""

from __future__ import annotations

from rtc.model.cells import parts
from rtc.spatial.geometry import Floats
from workers.planning.world_query import WorldQuery

#: states of a plug: its latch has clicked, and has borne a tug; its latch holds nothing
MATED, FREE = STATES = ("MATED", "FREE")


def plug(query: WorldQuery, thing: str) -> parts.Object | None:
    """The object, if it is a plug."""
    return next((one for one in query.cell.objects if one.name == thing and one.plug is not None), None)


def socket(query: WorldQuery, thing: str, frame: Floats | None = None) -> parts.Seat | None:
    """The socket in which a plug is, wholly or in part; None if it is in none. `frame`: where it is, if it is known."""
    name = query.slot_at(query.frame(thing) if frame is None else frame)
    seat = query.cell.seat(name) if name else None
    return seat if seat is not None and seat.mating is not None else None


def state(query: WorldQuery, thing: str) -> str:
    """MATED or FREE; without a fact a plug that the cell file has in a socket is mated."""
    known = query.world.value(f"{thing}.mating")
    if known is not None:
        return str(known)
    seat = query.cell.object(thing).seat
    return MATED if seat and query.cell.seat(seat).mating is not None and query.seat(thing) == seat else FREE


def may_be_mated(query: WorldQuery, thing: str) -> bool:
    """Whether its latch may hold a plug: it is believed to, or it is in doubt whether it does."""
    return state(query, thing) == MATED or not query.trusts(f"{thing}.mating")
