"""Objects and seats: which seat an object is in, and what goes with a seat that is elsewhere. Pure."""

from __future__ import annotations

import math

from rtc.protocol.messages import Validity, WorldChange
from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats
from rtc.world.spread import Spread, even, widened
from workers.planning import pose_spread
from workers.planning.world_query import WorldQuery

CAUGHT_M, CAUGHT_RAD = 0.004, 0.05  # maximum distance from the seated pose at which a catch holds an object
IN_SEAT_M = 0.02  # an object released within this distance of its seated pose stays in the seat
TURNED_M, TURNED_RAD = 0.008, 0.15  # how far a seat moves and turns an object in the hand: up to 4.3 mm and 4.9 deg


def content(
    query: WorldQuery, seat: str, frame: Floats, spread: Spread | None = None, validity: Validity = Validity.VALID
) -> list[WorldChange]:
    """Objects in a seat move with it. They are as unsure as before, or `spread` (of the seat) more."""
    changes = []
    for thing in query.cell.objects:
        if query.seat(thing.name) == seat and moves_with(thing.name, seat, frame, query):
            key, inside = f"{thing.name}.frame", geometry.relative(query.seat_frame(seat), query.frame(thing.name))
            fact, value = query.world.get(key), geometry.normalise(geometry.compose(frame, inside)).tolist()
            unsure = fact.spread if fact is not None else None
            if spread is not None:
                unsure = widened(pose_spread.spread_at(spread, inside), query.spread(key))
            valid = fact.validity if fact is not None and validity is Validity.VALID else validity
            changes.append(WorldChange(key=key, value=value, validity=valid, spread=unsure))
    return changes


def moves_with(thing: str, seat: str, frame: Floats, query: WorldQuery) -> bool:
    """Whether an object in a seat moves with it when the seat is at this frame.

    An object whose own place is known better than that of the seat was measured by itself. It stays where it is while
    the seat is within its former spread: then the seat has not moved, it is only known better.
    """
    if query.held_by(thing):
        return False
    fact, surveyed = query.world.get(f"{thing}.frame"), query.cell.object(thing).surveyed_spread
    if fact is None or fact.spread is None:
        return True  # stated to be exact, as its seat is
    was = query.spread(f"{seat}.frame")
    if query.world.get(f"{seat}.frame") is None and surveyed is not None:
        was = surveyed  # the survey of the object is that of its seat
    if max(fact.spread[:3]) >= max(was[:3]):
        return True
    before = query.seat_frame(seat)
    return any(abs(error) > bound for error, bound in zip(pose_spread.error_of(before, frame), was, strict=True))


def seat_at(frame: Floats, query: WorldQuery, within_m: float, within_rad: float = math.pi) -> str:
    """The seat whose seated pose is nearest within both tolerances; empty if there is none."""
    places = {seat.name: query.seated_pose(seat.name) for seat in query.cell.seats}
    away_m = {name: geometry.distance(frame, place) for name, place in places.items()}
    near = [name for name, at in places.items() if away_m[name] <= within_m and geometry.angle(frame, at) <= within_rad]
    return min(near, key=lambda name: away_m[name], default="")


def its_frame(
    query: WorldQuery, thing: str, frame: Floats, spread: Spread, play_m: float, validity: Validity
) -> list[WorldChange]:
    """The frame of the seat that holds an object at this frame (world), up to its play; nothing without a play."""
    seat = query.seat(thing)
    if not seat or play_m <= 0.0:
        return []
    inside = geometry.inverse(query.cell.seat(seat).module_frame.pose)
    place = geometry.normalise(geometry.compose(frame, inside)).tolist()
    wider = pose_spread.spread_at(widened(spread, even(play_m, 0.0)), inside)
    return [WorldChange(key=f"{seat}.frame", value=place, validity=validity, spread=wider)]


def set_down(query: WorldQuery, thing: str, seat: str) -> tuple[Array, list[float]]:
    """Pose of an object that was let go of in a seat: from its catch or from the hand, whichever is narrower.

    A catch holds the object near the seated pose. The hand had it where it is, but a seat may have turned it.
    """
    hand = widened(query.spread(f"{thing}.frame"), even(TURNED_M, TURNED_RAD))
    in_seat = query.cell.seat(seat)
    if in_seat.detent_n <= 0.0:
        return query.frame(thing), hand
    bounds = pose_spread.spread_at(query.spread(f"{seat}.frame"), in_seat.module_frame.pose)
    caught = widened(bounds, even(CAUGHT_M, CAUGHT_RAD))
    return min((query.seated_pose(seat), caught), (query.frame(thing), hand), key=lambda found: sum(found[1]))
