"""What goes with a body that a camera has seen: objects in a seat, and what is mounted on a fixed object. Pure."""

from __future__ import annotations

import numpy as np

from rtc.model.cells import parts
from rtc.protocol.messages import Fact, Validity, WorldChange
from rtc.spatial import geometry, hinges
from rtc.spatial.geometry import Array
from rtc.world.spread import EXACT, Spread, even, widened
from workers.analyzer.reported_facts import moves_with
from workers.planning import pose_spread
from workers.planning.world_query import WorldQuery

Changes = list[WorldChange]


def content(query: WorldQuery, seat: str, frame: Array, spread: Spread, validity: Validity) -> Changes:
    """Objects in a seat move with it."""
    changes = []
    for thing in query.cell.objects:
        if query.seat(thing.name) == seat and moves_with(thing.name, seat, frame, query):
            inside = geometry.relative(query.seat_frame(seat), query.frame(thing.name))
            wider = widened(pose_spread.spread_at(spread, inside), query.spread(f"{thing.name}.frame"))
            value = geometry.normalise(geometry.compose(frame, inside)).tolist()
            key = f"{thing.name}.frame"
            fact = query.world.get(key)
            valid = fact.validity if fact is not None and validity is Validity.VALID else validity
            changes.append(WorldChange(key=key, value=value, validity=valid, spread=wider))
    return changes


def mounted(query: WorldQuery, body: WorldChange) -> Changes:
    """What is mounted on a body is where the body has it, after this change of the body's frame.

    What was measured by itself, as well as the body or better, stays where it is, if the body has it there as far as
    both are known. Of an object with a hinge the angle counts from the hinge on the body in either case. One in a hand
    turns about that hinge to where the hand has it.
    """
    changes: Changes = []
    after, name = query.after([body]), body.key.rpartition(".")[0]
    for part in query.cell.mounted(name):
        key = f"{part.name}.frame"
        fact, place = query.world.get(key), _in_place(after, part, query.angle(part.name))
        surveyed = (isinstance(part, parts.Object) and part.surveyed_spread) or EXACT
        on_body = pose_spread.spread_at(body.spread or EXACT, geometry.relative(after.frame(name), place))
        spread = widened(on_body, surveyed)
        validity = fact.validity if fact is not None and body.validity is Validity.VALID else body.validity
        if isinstance(part, parts.Object) and query.held_by(part.name):
            changes += _in_hand(after, part, spread)
            continue
        if fact is not None and _is_known_there(after, part, fact, spread, surveyed):
            changes.append(WorldChange(key=key, value=fact.value, validity=fact.validity, spread=fact.spread))
            continue
        place = geometry.normalise(place)
        changes.append(WorldChange(key=key, value=place.tolist(), validity=validity, spread=spread))
        if isinstance(part, parts.Seat):
            changes += content(query, part.name, place, spread, validity)
    return changes


def _in_hand(query: WorldQuery, part: parts.Object, spread: list[float]) -> Changes:
    """A held object with a hinge: its hand has the bar, and the body has the hinge. It is unsure by as much as they
    disagree."""
    grasp = query.grasp(part.name)
    if part.hinge is None or grasp is None:
        return []
    bar = hinges.bar((point.frame.xyz for point in part.grasp_points), grasp)
    where = geometry.transform_point(query.frame(part.name), bar)
    place = hinges.at_hand(query.mount(part), part.hinge.axis, part.hinge.range_rad, bar, where)
    inside = geometry.relative(query.tcp(query.held_by(part.name)), place)
    off_m = float(np.linalg.norm(geometry.transform_point(place, bar) - where))
    lever_m = float(np.linalg.norm(np.cross(part.hinge.axis, bar)))
    spread = widened(spread, even(off_m, off_m / lever_m))
    values = {"frame": place, "grasp": inside}
    return [
        WorldChange(
            key=f"{part.name}.{name}",
            value=geometry.normalise(pose).tolist(),
            validity=query.world.facts[f"{part.name}.{name}"].validity,
            spread=spread,
        )
        for name, pose in values.items()
    ]


def _in_place(query: WorldQuery, part: parts.Seat | parts.Object, angle: float) -> Array:
    """The frame of a part on its body; of one with a hinge at this angle (rad), of a bolt as far out as it is."""
    home = query.mount(part)
    if isinstance(part, parts.Object) and part.hinge is not None:
        return hinges.turned(home, part.hinge.axis, angle)
    if isinstance(part, parts.Object) and part.thread is not None:
        out_m = part.thread.pitch_m * query.turns(part.name)
        return geometry.compose(home, (0.0, 0.0, out_m, 0.0, 0.0, 0.0, 1.0))
    return home


def _is_known_there(
    query: WorldQuery, part: parts.Seat | parts.Object, fact: Fact, spread: Spread, surveyed: Spread
) -> bool:
    """Whether a part was measured by itself where its body has it, and at least as well."""
    own = fact.spread
    if own is None or list(own) == list(surveyed) or max(own[:3]) > max(spread[:3]):
        return False
    hinge = part.hinge if isinstance(part, parts.Object) else None
    angle = hinges.angle_of(query.mount(part), hinge.axis, fact.value) if hinge is not None else 0.0
    place = _in_place(query, part, angle)
    off = pose_spread.error_of(place, fact.value)
    return all(abs(error) <= bound for error, bound in zip(off, widened(spread, own), strict=True))
