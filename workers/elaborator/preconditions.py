"""Preconditions of scripts by registered name, and the advice that establishes an unmet one. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable

from rtc.language.hands import hand_in_words
from rtc.protocol.advice import Advice, Texts, fill_in
from rtc.protocol.causes import NeedUnmet
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial import geometry
from workers.mechanisms import joined
from workers.planning import trust
from workers.planning.motion import ik
from workers.planning.world_query import WorldQuery
from workers.tasks.candidate import TaskCandidate
from workers.tasks.unmet import UnmetPrecondition

IN_SEAT_M = 0.02  # an object released within this distance of its seated pose stays in the seat
IN_HAND_M = 0.06  # maximum distance of a held object's grasp point from the middle between the fingers
WIDER_M = 0.006  # fingers wider than the object by more than this do not hold it


def seat_of(query: WorldQuery, thing: str) -> str:
    """The seat in which an object would stay after it is let go; empty if there is none."""
    frame = query.frame(thing)
    seats = (seat.name for seat in query.cell.seats)
    return next((name for name in seats if geometry.distance(frame, query.seated_pose(name)) < IN_SEAT_M), "")


def _hand_empty(candidate: TaskCandidate) -> UnmetPrecondition | None:
    held = candidate.query.holding(candidate.arm.name)
    return UnmetPrecondition(f"{candidate.arm.name} holds {held}", held) if held else None


def _object_free(candidate: TaskCandidate) -> UnmetPrecondition | None:
    assert candidate.thing is not None
    if candidate.thing.fixed:
        return UnmetPrecondition(f"{candidate.thing.name} is fixed", candidate.thing.name, "object_fixed")
    name = candidate.thing.name
    if holder := candidate.query.held_by(name):
        return UnmetPrecondition(f"{name} is held by {holder}", holder, thing=name)
    return _perhaps_held(candidate)


def _perhaps_held(candidate: TaskCandidate) -> UnmetPrecondition | None:
    assert candidate.thing is not None
    name = candidate.thing.name
    perhaps = next((arm.name for arm in candidate.query.cell.arms if _may_hold(candidate, arm.name)), "")
    return UnmetPrecondition(f"{perhaps} may hold {name}", perhaps, "object_perhaps_held", name) if perhaps else None


def _may_hold(candidate: TaskCandidate, arm: str) -> bool:
    """Whether the hand may hold the object of the candidate, although no fact states it.

    The facts are in doubt, the hand is not known to be open, and it is near the object.
    """
    query, thing = candidate.query, candidate.thing
    assert thing is not None
    certain = query.trusts(f"{arm}.holding") and query.trusts(f"{thing.name}.held_by")
    if certain or query.holding(arm):
        return False
    frame, tcp = query.frame(thing.name), query.tcp(arm)
    reach_m = IN_HAND_M + math.hypot(*query.spread(f"{thing.name}.frame")[:3])
    open_m = query.hand_width(arm) - WIDER_M if query.trusts(f"{arm}.hand_width") else -math.inf
    return any(
        open_m <= point.width_m and geometry.distance(tcp, geometry.compose(frame, point.frame.pose)) < reach_m
        for point in thing.grasp_points
    )


def _object_held(candidate: TaskCandidate) -> UnmetPrecondition | None:
    assert candidate.thing is not None
    holder = candidate.query.held_by(candidate.thing.name)
    second = bool(holder) and candidate.query.holding(candidate.arm.name) == candidate.thing.name
    if holder == candidate.arm.name or second:
        return None
    if holder:
        message = f"{candidate.thing.name} is held by {holder}, not by {candidate.arm.name}"
        return UnmetPrecondition(message, holder, "held_by_another", candidate.thing.name)
    other = candidate.query.holding(candidate.arm.name) if candidate.parsed.hand else ""
    if other:
        return UnmetPrecondition(
            f"{candidate.thing.name} is not held, and {candidate.arm.name} holds {other}", other, "hand_full"
        )
    return _perhaps_held(candidate) or UnmetPrecondition(f"{candidate.thing.name} is not held", candidate.thing.name)


def _object_seated(candidate: TaskCandidate) -> UnmetPrecondition | None:
    assert candidate.thing is not None
    name = candidate.thing.name
    if candidate.thing.hinge is not None or candidate.query.sharers(candidate.arm.name):
        return None
    return (
        None
        if seat_of(candidate.query, name)
        else UnmetPrecondition(f"{name} is not in a seat, and would drift away", name)
    )


def _seat_free(candidate: TaskCandidate) -> UnmetPrecondition | None:
    assert candidate.target is not None
    inside = [t.name for t in candidate.query.cell.objects if candidate.query.seat(t.name) == candidate.target.name]
    others = [name for name in inside if candidate.thing is None or name != candidate.thing.name]
    return UnmetPrecondition(f"{candidate.target.name} holds {others[0]}", others[0]) if others else None


def _width_known(candidate: TaskCandidate) -> UnmetPrecondition | None:
    known = candidate.query.trusts(f"{candidate.arm.name}.hand_width")
    return (
        None
        if known
        else UnmetPrecondition(f"it is not known how wide the hand of {candidate.arm.name} is open", candidate.arm.name)
    )


def _object_in_target(candidate: TaskCandidate) -> UnmetPrecondition | None:
    """The object is in the seat of the sentence, or still in its slot."""
    assert candidate.thing is not None
    assert candidate.target is not None
    name, target = candidate.thing.name, candidate.target.name
    seat = candidate.query.seat(name) or candidate.query.seat_around(name)
    return None if seat == target else UnmetPrecondition(f"{name} is in {seat or 'no seat'}, not in {target}", seat)


NEEDS: dict[str, Callable[[TaskCandidate], UnmetPrecondition | None]] = {
    "hand_empty": _hand_empty,
    "object_free": _object_free,
    "object_held": _object_held,
    "object_seated": _object_seated,
    "seat_free": _seat_free,
    "width_known": _width_known,
    "object_in_target": _object_in_target,
    **joined(lambda mechanism: mechanism.needs),
}


def refuse_if_unmet(need: str, candidate: TaskCandidate) -> None:
    """Refuse an unmet precondition, with the sentence that establishes it."""
    lack = NEEDS[need](candidate)
    if lack is None:
        return
    rows = candidate.program.needs
    thing = lack.thing or lack.held
    row = lack.row or need
    if candidate.parsed.hand and f"{row}_by" in rows:  # with the hand of the sentence first
        row = f"{row}_by"
    texts: Texts = {"let_go": let_go(rows, candidate.query, thing), "hand": hand_in_words(candidate.arm.name)}
    clears = fill_in(rows.get(row, []), {**texts, **candidate.texts, "held": lack.held})
    doubt = (
        trust.distrusted(candidate.query, f"{candidate.thing.name}.held_by", {})
        if candidate.thing is not None
        else None
    )
    message = lack.message + (f", but {doubt.message}" if doubt else "")
    cause = NeedUnmet(need=lack.row or need, by=lack.held, doubt=doubt.where if doubt else "")
    raise Refused.because(RefusalReason.STATE, message, clears=clears, cause=cause)


def let_go(rows: dict[str, Advice], query: WorldQuery, thing: str) -> Advice:
    """The command that empties the hand: in place if the object stays there; else into a free seat in its reach."""
    if thing not in {known.name for known in query.cell.objects} or query.hinge(thing) or seat_of(query, thing):
        return fill_in(rows.get("let_go", []), {"held": thing})
    taken = {query.seat(known.name) for known in query.cell.objects if known.name != thing}
    free = [seat.name for seat in query.cell.seats if seat.name not in taken and _reaches(query, thing, seat.name)]
    row = "let_go_in_air" if free else "let_go"
    return fill_in(rows.get(row, []), {"held": thing, "free": free})


def _reaches(query: WorldQuery, thing: str, seat: str) -> bool:
    """Whether the arm that holds the object has a posture with it in the seat; true if its place in the hand is not
    known."""
    arm, grasp = query.held_by(thing), query.grasp(thing)
    if arm not in query.model.arms or grasp is None:
        return True
    tcp = geometry.compose(query.seated_pose(seat), geometry.inverse(grasp))
    return bool(ik.solutions(query.algorithms.ik, query.model.arms[arm], tcp.tolist()).found)
