"""What follows for seats, and for what is in them, if the frame of one of them is stated. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rtc.protocol.causes import NeedUnmet
from rtc.protocol.messages import WorldChange
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial import geometry
from rtc.world.facts import TRUSTED
from rtc.world.model import location
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


def contradictions(
    changes: Sequence[WorldChange], query: WorldQuery, after: WorldQuery, values: Mapping[str, float]
) -> Iterator[tuple[str, str]]:
    """Two objects in one seat, or one that is not where its seat is."""
    stated = {location(change.key) for change in changes}
    inside: dict[str, str] = {}
    for thing in query.cell.objects:
        key, seat = f"{thing.name}.seat", after.seat(thing.name)
        if not seat or not after.trusts(key) or not query.is_seat(seat):
            continue
        other = inside.setdefault(seat, thing.name)
        if other != thing.name and stated & {other, thing.name}:
            yield key, f"{other} and {thing.name} would both be in {seat}"
        frame = after.world.get(f"{thing.name}.frame")
        if thing.name not in stated or frame is None or frame.validity not in TRUSTED:
            continue
        off_m = geometry.distance(after.frame(thing.name), after.seated_pose(seat))
        if off_m > values["seated_m"]:
            yield key, f"{thing.name} would be in {seat}, and {off_m * 1000:.0f} mm from its place there"
