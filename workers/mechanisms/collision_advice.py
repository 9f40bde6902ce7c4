"""Advice for blocked motions: selects the row of the program's `clears` that applies and fills it in."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping

import msgspec

from rtc.language.hands import hand_in_words
from rtc.protocol.advice import ANOTHER_ARM, Advice, Alternative, Texts, fill_in
from rtc.protocol.causes import Collides
from rtc.protocol.messages import Limits
from rtc.protocol.outcomes import Refusal
from workers.mechanisms import each
from workers.planning import in_seat, lines_of_sight, trust
from workers.planning.scenes import CLEARANCE_M, clearance_of
from workers.planning.world_query import WorldQuery

UNLIMITED = Limits()
PICTURES = 2  # of a look for a body at rest, as its primitive has them
LEAST_ROOM_MM = 1  # that is advised: the least of AVOID-NEIGHBORS

WAYS, ABOUT = each(lambda mechanism: mechanism.way), each(lambda mechanism: mechanism.about)


def advise_on_collision(
    refusal: Refusal,
    query: WorldQuery,
    arm: str,
    clears: Mapping[str, Advice],
    limits: Limits = UNLIMITED,
    goal: str = "",
    leaves_seat: bool = False,
    closer: Callable[[int], str] = lambda _: "",
    has_others: bool = False,
    has_left: bool = False,
) -> Refusal:
    """Add advice to the refusal of a colliding motion of this arm; other refusals are returned unchanged. `limits`: of
    the command. `goal`: the place that it names. `leaves_seat`: it takes the held object out of its seat. `closer`: the
    same sentence with AVOID-NEIGHBORS of so many millimetres. `has_others`: there may be sentences in its place, so
    no look is advised that is not expected to make enough room. `has_left`: the held object has left its seat before.
    """
    cause = refusal.cause
    if not isinstance(cause, Collides):
        return refusal
    bodies = cause.owners
    held = query.holding(arm)
    seat = query.seat(held) or query.seat_around(held) if held and not has_left else ""
    body = next((name for name in bodies if name not in (arm, held)), bodies[1])
    other = refusal.in_the_way
    leaves = cause.leaving  # first: other arms are passed by ways that are not sought before
    seated = bool(seat) and held in bodies
    own = next(filter(None, (way(refusal, query, arm, body) for way in WAYS)), "")
    unsure = "" if seated or other or leaves else _unsure(cause, query, bodies, limits)
    if unsure and has_others and not _looks_make_room(cause, query, bodies):
        unsure = ""
    if unsure and (not own or query.cameras(unsure.rpartition(".")[0])):
        return msgspec.structs.replace(refusal, clears=trust.narrows(query, unsure, clears))
    if leaves and held in bodies and not seated and query.cameras(held):  # it creeps in the hand
        return msgspec.structs.replace(refusal, clears=trust.narrows(query, f"{held}.grasp", clears))
    row = (
        ("way_out" if seated and leaves_seat else "")
        or ("way_seated" if seated else "")
        or ("way_unsure" if leaves else "")
        or _kept_out(cause, body, limits)
        or ("way_other" if other else "")
        or own
        or _at_goal(refusal, query, body)
        or ("way_shared" if query.sharers(arm) else "way_far" if _far(refusal) and "way_far" in clears else "way")
    )
    known = [place for place in query.places if arm in place.poses or arm in place.joints_deg]
    texts: Texts = {
        "closer": _closer(cause, closer) if row == "way_neighbors" or _is_room(cause, limits) else [],
        "place": [place.name for place in known if place.name != goal],
        "another_arm": [ANOTHER_ARM] if not held and _another_may(query, arm, goal) else [],
        "arm": hand_in_words(arm),
        "held": held,
        "seat": seat,
        "lift": in_seat.way_out_in_words(query, arm, seat) if seat else "",
        "body": leaves or body,
        "other": hand_in_words(other),
        **about(query, body),
    }
    return msgspec.structs.replace(refusal, clears=fill_in(clears.get(row, []), texts))


def about(query: WorldQuery, body: str) -> Texts:
    """The texts of all mechanisms about a body that blocks a way or a view."""
    return {name: text for about_body in ABOUT for name, text in about_body(query, body).items()}


def _closer(cause: Collides, closer: Callable[[int], str]) -> Advice:
    """The sentence with a distance for which there is room; in words if it is not known."""
    room_mm = _room_mm(cause)
    sentence = closer(room_mm)
    words = "" if sentence else f"MAINTAIN AVOID-NEIGHBORS BY {room_mm} MM"
    return [Alternative(sentences=[sentence] if sentence else [], words=words, instead=bool(sentence))]


def _another_may(query: WorldQuery, arm: str, goal: str) -> bool:
    """Whether the place that is the goal, if one is named, is one of another arm, too."""
    able = next(({*place.poses, *place.joints_deg} for place in query.places if place.name == goal), None)
    return able is None or bool(able - {arm})


def _unsure(cause: Collides, query: WorldQuery, bodies: Iterable[str], limits: Limits) -> str:
    """The key of the fact whose spread alone asks for more room than there is; empty if there is none."""
    if cause.distance_m < clearance_of(limits):
        return ""
    keys = [key for body in bodies if (key := trust.unsure_key(query, body)) and not trust.better_than_seen(query, key)]
    return max(keys, key=lambda key: trust.off_m(query, key.rpartition(".")[0], query.spread(key)), default="")


def _looks_make_room(cause: Collides, query: WorldQuery, bodies: Iterable[str]) -> bool:
    """Whether looks at these bodies, or poses that a person states, are expected to make enough room."""
    keys = filter(None, (trust.unsure_key(query, body) for body in bodies))
    return cause.distance_m + sum(_gain_m(query, key) for key in keys) >= cause.margin_m


def _gain_m(query: WorldQuery, key: str) -> float:
    """By how much a pose will be known better after a look; a person who states it may know it exactly."""
    body = key.rpartition(".")[0]
    known_m = trust.off_m(query, body, query.spread(key))
    cameras = [camera.name for camera in query.cameras(body)]
    seen, _ = lines_of_sight.sighting(query, cameras, body, PICTURES)
    return known_m if seen is None else max(0.0, known_m - trust.sees_within_m(query, body, seen))


def _kept_out(cause: Collides, body: str, limits: Limits) -> str:
    """The row for a collision that only a MAINTAIN of the command makes one; empty for others."""
    if body in limits.keep_out:
        return "way_region"
    return "way_neighbors" if cause.distance_m > CLEARANCE_M and (limits.clearance_m or 0.0) > CLEARANCE_M else ""


def _is_room(cause: Collides, limits: Limits) -> bool:
    """Whether a smaller AVOID-NEIGHBORS would allow the motion, as far as this pair of bodies is concerned."""
    return LEAST_ROOM_MM <= _room_mm(cause) < 1e3 * cause.margin_m <= 1e3 * clearance_of(limits)


def _room_mm(cause: Collides) -> int:
    """The distance of AVOID-NEIGHBORS for which there is room: whole millimetres, and some micrometres less."""
    return math.floor(1e3 * cause.distance_m - 1e-3)


def _far(refusal: Refusal) -> bool:
    """Whether the way is blocked in its second half: to draw the arm back would not clear it."""
    return 0.5 < refusal.fraction < 1.0


def _at_goal(refusal: Refusal, query: WorldQuery, body: str) -> str:
    """The row for a goal in collision; empty if the collision is on the path to it."""
    if refusal.fraction < 1.0:
        return ""
    movable = {thing.name for thing in query.cell.objects if not thing.fixed}
    return "way_goal_movable" if body in movable else "way_goal"
