"""What no facts from outside may say, whichever way they come: SET of one, or all of a file. Pure.

The facts are judged together, as the world would be after them: attributes of another kind of part, postures that an
arm does not have, seats that do not exist, two objects in one seat, an object that is not where its seat is, an object
inside an arm or another object, an angle beyond its stops, a spread that says nothing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import msgspec

from rtc.model.cells import taught
from rtc.model.robot.collision_scene import Held
from rtc.protocol.messages import Limits, Validity, WorldChange
from rtc.protocol.outcomes import RefusalReason, Refused, refuse_if
from rtc.protocol.primitive.limits import HEAVIEST_KG
from rtc.spatial import geometry
from rtc.world.facts import TRUSTED
from rtc.world.model import ATTRIBUTES, location
from workers.mechanisms import each
from workers.planning import scenes
from workers.planning.world_query import WorldQuery

Values = Mapping[str, float]
Problems = Iterator[tuple[str, str]]  # key, problem

INSIDE_M = 0.005  # an object that is deeper in a link of an arm than this is not there; less is an error of its pose
#: attributes with a meaning
OF_OBJECT = ("frame", "seat", "held_by", "grasp", "mass")
ATTRIBUTES_OF, IMPOSSIBLE = each(lambda mechanism: mechanism.attributes), each(lambda mechanism: mechanism.impossible)
OF_USER = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")  # an attribute without one
OF_PLACE = re.compile(r"[A-Z][A-Z0-9]*(-[A-Z0-9]+)*")


def refuse(changes: Sequence[WorldChange], query: WorldQuery, values: Values) -> None:
    """Raises Refused with the first fact that cannot be."""
    after = query.after(changes)
    for check in CHECKS:
        for key, problem in check(changes, query, after, values):
            clears = "correct it, or leave it out"
            raise Refused.because(RefusalReason.INFEASIBLE, problem, where=key, clears=clears)


def _spreads(changes: Sequence[WorldChange], query: WorldQuery, after: WorldQuery, values: Values) -> Problems:
    for change in changes:
        if change.spread is None:
            continue
        now = query.world.get(change.key)
        if max(change.spread[:3]) > values["reach_m"] or max(change.spread[3:]) > math.pi:
            most = f"{values['reach_m']:g} m and half a turn are the most"
            yield change.key, f"the spread of {change.key} does not say where it is; {most}"
        elif not any(change.spread) and (now is None or now.spread is None or any(now.spread)):
            yield change.key, f"the spread of {change.key} is 0 about all axes; nothing is known that well"


def _names(changes: Sequence[WorldChange], query: WorldQuery, after: WorldQuery, values: Values) -> Problems:
    seats = {seat.name for seat in query.cell.seats}
    arms, things = {arm.name for arm in query.cell.arms}, {thing.name for thing in query.cell.objects}
    known = {"seat": ("seat", seats), "held_by": ("arm", arms), "holding": ("object", things)}
    for change in changes:
        kind, names = known.get(change.key.rpartition(".")[2], ("", set[str]()))
        if kind and change.value and not change.keep_value and change.value not in names:
            there = ", ".join(sorted(names))
            yield change.key, f"{change.key} is {change.value!s:.40}, and there is no such {kind}; there are {there}"


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


def _postures(changes: Sequence[WorldChange], query: WorldQuery, after: WorldQuery, values: Values) -> Problems:
    arms = {arm.name: len(arm.joints) for arm in query.cell.arms}
    margin_rad = math.radians(query.cell.numbers.joint_margin_deg)
    for change in changes:
        place, _, attribute = change.key.rpartition(".")
        if not attribute.startswith(taught.POSTURE):
            continue
        arm, posture = taught.arm_of(attribute), change.value
        if arm not in arms:
            yield change.key, f"{change.key} is of {arm}, and there is no such arm; there are {', '.join(arms)}"
        elif what := taught.taken(query.cell, place) or ("" if OF_PLACE.fullmatch(place) else "not a name"):
            yield change.key, f"{place!s:.40} is {what}; a taught place needs a name of its own"
        elif change.key != taught.key_of(place, arm):
            yield change.key, f"the key of this posture is {taught.key_of(place, arm)}"
        elif posture is not None and not _is_posture(posture, arms[arm]):
            yield change.key, f"{change.key} must be {arms[arm]} numbers (rad; m of a joint that slides)"
        elif posture is not None:
            refuse_if(query.model.arms[arm].why_not_within(posture, margin_rad))


def _is_posture(value: Any, joints: int) -> bool:
    return isinstance(value, list) and len(value) == joints and all(isinstance(one, int | float) for one in value)


def _figures(changes: Sequence[WorldChange], query: WorldQuery, after: WorldQuery, values: Values) -> Problems:
    things = {thing.name: thing for thing in query.cell.objects}
    for change in changes:
        thing, attribute = things.get(location(change.key)), change.key.rpartition(".")[2]
        if thing is None or change.value is None or change.keep_value:
            continue
        if not thing.fixed and attribute == "mass" and change.value > HEAVIEST_KG:
            yield change.key, f"{change.key} would be {change.value:g} kg; a load has at most {HEAVIEST_KG:g} kg"
        yield from ((change.key, why) for impossible in IMPOSSIBLE if (why := impossible(change, thing, after)))


def _seats(changes: Sequence[WorldChange], query: WorldQuery, after: WorldQuery, values: Values) -> Problems:
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


CHECKS = (_attributes, _postures, _spreads, _names, _figures, _seats, _arms, _bodies)
