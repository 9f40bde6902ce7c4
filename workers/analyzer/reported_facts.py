"""Reported facts of objects that no arm touched (stated or observed): checked, then converted to world changes. Pure.

If one fact is implausible, all are refused. Plausible facts are accepted as reported, with their consequences. They are
judged together, as the world would be after them: attributes of another kind of part, an object inside an arm or
another object, and what a mechanism finds.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import msgspec

from rtc.model.cells import taught
from rtc.model.robot.collision_scene import Held
from rtc.protocol.messages import Limits, Validity, WorldChange
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial import geometry
from rtc.world.model import ATTRIBUTES, location, problem
from workers.mechanisms import each, joined
from workers.planning import scenes, trust
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import Changes

Values = Mapping[str, float]
Problems = Iterator[tuple[str, str]]  # key, problem

PLAUSIBLE, FOLLOWS = joined(lambda mechanism: mechanism.plausible), each(lambda mechanism: mechanism.follows)
ATTRIBUTES_OF, IMPOSSIBLE = each(lambda mechanism: mechanism.attributes), each(lambda mechanism: mechanism.impossible)
CONTRADICTIONS = [check for checks in each(lambda mechanism: mechanism.contradictions) for check in checks]
OF_OBJECT = ("frame", "seat", "held_by", "grasp", "mass")  # attributes with a meaning
OF_USER = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")  # an attribute without one
INSIDE_M = 0.005  # an object that is deeper in a link of an arm than this is not there; less is an error of its pose


def changes_from(facts: Mapping[str, Any], query: WorldQuery, values: Values) -> Changes:
    """World changes for all facts. Raises Refused for an implausible one."""
    changes: Changes = []
    for key, value in facts.items():
        thing, _, attribute = key.rpartition(".")
        if attribute == "frame" and value is None:
            changes += _unplaced(thing, query)
            continue
        stored = next(iter(value)) if attribute == "facts" and isinstance(value, dict) else value
        spread = trust.stated_spread(query.cell.numbers) if attribute == "frame" else None
        change = WorldChange(key=key, value=stored, spread=spread)
        if wrong := problem(change) or (PLAUSIBLE[attribute](key, value, values) if attribute in PLAUSIBLE else ""):
            clears = "repeat it with the correct value and unit"
            raise Refused.because(RefusalReason.INFEASIBLE, wrong, where=key, clears=clears)
        changes.append(change)
        for follows in (table[attribute] for table in FOLLOWS if attribute in table):
            changes += follows(thing, value, query, values)
    after = query.after(changes)
    for check in (_attributes, _figures, *CONTRADICTIONS, _arms, _bodies):
        for key, wrong in check(changes, query, after, values):
            raise Refused.because(RefusalReason.INFEASIBLE, wrong, where=key, clears="correct it, or leave it out")
    return changes


def _unplaced(thing: str, query: WorldQuery) -> Changes:
    """The pose of an object or seat is stated to be unknown: the last belief stays as a guess."""
    frame = WorldChange(key=f"{thing}.frame", keep_value=True, validity=Validity.UNKNOWN)
    if query.is_seat(thing):
        inside = query.inside(thing)
        content = [WorldChange(key=f"{name}.frame", keep_value=True, validity=Validity.SUSPECT) for name in inside]
        known = msgspec.structs.replace(frame, value=query.seat_frame(thing).tolist(), keep_value=False)
        return [known, *content]
    return [frame, WorldChange(key=f"{thing}.seat", keep_value=True, validity=Validity.UNKNOWN)]


# --- what cannot be --------------------------------------------------------------------------------------


def _attributes(changes: Sequence[WorldChange], query: WorldQuery, after: WorldQuery, values: Values) -> Problems:
    """An attribute with a meaning says something about one kind of part, and nothing about others."""
    seats = {seat.name for seat in query.cell.seats}
    things = {thing.name: thing for thing in query.cell.objects}
    for change in changes:
        place, _, attribute = change.key.rpartition(".")
        thing = things.get(place)
        if attribute.startswith(taught.POSTURE) or place not in (*seats, *things):
            continue
        if not OF_USER.fullmatch(attribute):
            yield change.key, f"{attribute!r:.40} is not the name of an attribute"
        own = {"frame"} if thing is None else {*OF_OBJECT, *(name for of in ATTRIBUTES_OF for name in of(thing))}
        if attribute in ATTRIBUTES and attribute not in own and change.value is not None:
            kind = "a seat" if thing is None else "this object"
            yield change.key, f"{place} has no {attribute}: of {kind} there are {', '.join(sorted(own))}"


def _figures(changes: Sequence[WorldChange], query: WorldQuery, after: WorldQuery, values: Values) -> Problems:
    things = {thing.name: thing for thing in query.cell.objects}
    for change in changes:
        thing = things.get(location(change.key))
        if thing is not None and change.value is not None and not change.keep_value:
            yield from ((change.key, why) for impossible in IMPOSSIBLE if (why := impossible(change, thing, after)))


def _arms(changes: Sequence[WorldChange], query: WorldQuery, after: WorldQuery, values: Values) -> Problems:
    """Objects inside of arms. An object in a hand is judged by its grasp, and the fingers may be around one that is
    believed some millimetres off."""
    placed = _placed(changes, after)
    if not placed:
        return
    joints = {arm.name: after.joints(arm.name) for arm in query.cell.arms}
    for arm in query.cell.arms:
        scene = scenes.scene_of(after, arm.name, Limits(), unsure=False)
        fingers = {f"{arm.name} {link}" for link in arm.gripper.finger_links}
        for hit in query.model.collision.too_near(joints, scene):
            of_arm = hit.body_a.startswith(f"{arm.name} ") and hit.body_a not in fingers
            if of_arm and hit.body_b.split()[0] in placed and hit.distance_m < -INSIDE_M:
                depth_mm = -hit.distance_m * 1000
                yield f"{hit.body_b.split()[0]}.frame", f"{hit.body_b} would be {depth_mm:.0f} mm inside {hit.body_a}"


def _bodies(changes: Sequence[WorldChange], query: WorldQuery, after: WorldQuery, values: Values) -> Problems:
    """Movable objects inside of each other, deeper than both may be off: two of them at one place.

    The check asks for pairs with a moving body, so the object is asked about as if an arm held it there."""
    arm = query.cell.arms[0].name
    joints, tcp = {one.name: after.joints(one.name) for one in query.cell.arms}, after.tcp(arm)
    movable = {thing.name for thing in query.cell.objects if not (thing.fixed or thing.hinge or thing.thread)}
    for thing in sorted(_placed(changes, after) & movable):
        scene = scenes.scene_of(after, arm, Limits(), unsure=False)
        held = Held(arm, geometry.compose(geometry.inverse(tcp), after.frame(thing)))
        scene = msgspec.structs.replace(scene, held={**scene.held, thing: held}, ignore=[])
        for hit in query.model.collision.too_near(joints, scene):
            pair = {body.split()[0] for body in (hit.body_a, hit.body_b)}
            off_m = 2.0 * sum(max(after.spread(f"{name}.frame")[:3]) for name in pair)
            if thing in pair <= movable and len(pair) == 2 and hit.distance_m < -INSIDE_M - off_m:
                (other,) = pair - {thing}
                yield f"{thing}.frame", f"{thing} would be {-hit.distance_m * 1000:.0f} mm inside {other}"


def _placed(changes: Sequence[WorldChange], after: WorldQuery) -> set[str]:
    """Objects that get a valid frame and are in no hand."""
    stated = {location(c.key) for c in changes if c.key.endswith(".frame") and c.validity is Validity.VALID}
    return {thing.name for thing in after.cell.objects if thing.name in stated and not after.held_by(thing.name)}
