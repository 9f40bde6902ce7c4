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
from rtc.world.model import location
from rtc.world.spread import Spread
from workers.mechanisms import each
from workers.planning import in_seat, lines_of_sight, trust
from workers.planning.scenes import CLEARANCE_M, clearance_of
from workers.planning.world_query import WorldQuery

UNLIMITED = Limits()
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
    has_left: bool = False,
) -> Refusal:
    """Add advice to the refusal of a colliding motion of this arm; other refusals are returned unchanged. `limits`: of
    the command. `goal`: the place that it names. `leaves_seat`: it takes the held object out of its seat. `closer`: the
    same sentence with AVOID-NEIGHBORS of so many millimetres. `has_left`: the held object has left its seat before.
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
    # what an arm may touch at its start is left first, unless another arm holds it and may hold it otherwise
    passes_by = seated or bool(other) != bool(leaves)
    unsure, within_m = ("", 0.0) if passes_by else _unsure(cause, query, bodies, limits)
    if unsure and (leaves or not own or query.cameras(location(unsure))):

        def makes_room(spread: Spread) -> bool:
            return trust.off_m(query, location(unsure), spread) <= within_m

        back = fill_in(clears.get("way_unsure", []), {"arm": hand_in_words(arm), "body": leaves}) if leaves else []
        return msgspec.structs.replace(refusal, clears=[*trust.narrows(query, unsure, clears, makes_room), *back])
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


def _unsure(cause: Collides, query: WorldQuery, bodies: Iterable[str], limits: Limits) -> tuple[str, float]:
    """The key of the fact whose spread asks for more room than there is, and how far off its body may be (m) for there
    to be enough; empty if neither looks nor statements are expected to make enough room."""
    if cause.distance_m < clearance_of(limits):
        return "", 0.0
    gains = {key: _gain_m(query, key) for body in bodies if (key := trust.unsure_key(query, body))}
    lacks_m = cause.margin_m - cause.distance_m - sum(gains.values())
    key = max(gains, key=lambda key: gains[key], default="")
    if not key or gains[key] <= 0.0 or lacks_m > 0.0:
        return "", 0.0
    return key, trust.off_m(query, location(key), query.spread(key)) - gains[key] - lacks_m


def _gain_m(query: WorldQuery, key: str) -> float:
    """By how much a pose will be known better after a look, or after a person has stated it."""
    body = location(key)
    known_m = trust.off_m(query, body, query.spread(key))
    better_m = [trust.off_m(query, body, trust.stated_spread(query.cell.numbers))]
    if (seen := trust.last_look(query, body)) is not None:
        better_m.append(trust.off_m(query, body, seen))
    else:
        cameras = [camera.name for camera in query.cameras(body)]
        expected, _ = lines_of_sight.sighting(query, cameras, body, query.cell.numbers.pictures)
        better_m += [] if expected is None else [trust.sees_within_m(query, body, expected)]
    return max(0.0, known_m - min(better_m))


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
