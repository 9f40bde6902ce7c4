"""Seats in a script: how far out of one an object is, whether one is free, and the hand when it is in. Pure."""

from __future__ import annotations

from typing import Any

import msgspec

from rtc.model.cells import parts
from rtc.programs.schema import ElaboratorProgram, ScriptFile
from rtc.protocol.messages import Step
from rtc.spatial import geometry
from rtc.world.spread import narrowest
from workers.mechanisms.mechanism import Thing
from workers.planning import suggestions, trust
from workers.planning.trust import AHEAD_S
from workers.planning.world_query import WorldQuery
from workers.tasks.anchor import Anchor, refused
from workers.tasks.candidate import TaskCandidate
from workers.tasks.seated import IN_SEAT_M, seat_at
from workers.tasks.unmet import UnmetPrecondition, refuse_held

IN_TARGET = "object_in_target"  # precondition of a script that takes an object out of its seat


def figures(candidate: TaskCandidate) -> dict[str, float]:
    """How far the object is in a slot, how deep the target is, and how unsure the object will be before it."""
    thing, target, found = candidate.thing, candidate.target, {}
    if thing is not None:
        found["slot_m"] = _slot_m(candidate.query, thing)
    if target is not None:
        found |= {"seat_depth_m": target.depth_m, "detent_n": target.detent_n}
        found["held_unsure_m"] = _held_unsure_m(candidate.query, thing, target) if thing is not None else 0.0
    return found


def _slot_m(query: WorldQuery, thing: parts.Object) -> float:
    """Way out (m) until an object is free of the slot that it is in; 0 if it is in none, or has a hinge."""
    seat = query.seat(thing.name) or query.seat_around(thing.name)
    if not seat or thing.hinge is not None:
        return 0.0
    return max(0.0, query.cell.seat(seat).depth_m - query.out_m(seat, query.frame(thing.name)))


def _held_unsure_m(query: WorldQuery, thing: parts.Object, target: parts.Seat) -> float:
    """How far any point of the held object may be from its believed place when it is before the seat.

    With a wider spread than the seat permits it does not get there."""
    spread = trust.grasp_spread(query, thing.name, AHEAD_S)
    return trust.off_m(
        query, thing.name, narrowest(spread, target.needs_within.spread) if target.needs_within else spread
    )


def object_seated(candidate: TaskCandidate) -> UnmetPrecondition | None:
    """The object stays where it is when it is let go of: in a seat, on its hinge, or in another hand."""
    assert candidate.thing is not None
    name, query = candidate.thing.name, candidate.query
    if candidate.thing.hinge is not None or query.sharers(candidate.arm.name):
        return None
    if seat_at(query.frame(name), query, IN_SEAT_M):
        return None
    return UnmetPrecondition(f"{name} is not in a seat, and would drift away", name)


def seat_free(candidate: TaskCandidate) -> UnmetPrecondition | None:
    """Nothing but the object of the sentence is in the target seat."""
    assert candidate.target is not None
    target, own = candidate.target.name, candidate.thing.name if candidate.thing is not None else ""
    others = [name for name in candidate.query.inside(target) if name != own]
    return UnmetPrecondition(f"{target} holds {others[0]}", others[0]) if others else None


def object_in_target(candidate: TaskCandidate) -> UnmetPrecondition | None:
    """The object is in the seat of the sentence, or still in its slot."""
    assert candidate.thing is not None
    assert candidate.target is not None
    name, target = candidate.thing.name, candidate.target.name
    seat = candidate.query.seat(name) or candidate.query.seat_around(name)
    return None if seat == target else UnmetPrecondition(f"{name} is in {seat or 'no seat'}, not in {target}", seat)


def taken_out(script: ScriptFile, candidate: TaskCandidate) -> tuple[str, str] | None:
    """That the object is out of its seat before the script begins, and the row of `needs`."""
    query, thing, target = candidate.query, candidate.thing, candidate.target
    if IN_TARGET not in script.needs or thing is None or target is None:
        return None
    out = not (query.seat(thing.name) or query.seat_around(thing.name))
    done = out and query.held_by(thing.name) == candidate.arm.name
    return (f"{thing.name} is out of {target.name} already", "taken_out_already") if done else None


def seat(candidate: TaskCandidate) -> Anchor:
    """The tcp pose at which the held object is seated in the target seat."""
    assert candidate.thing is not None
    assert candidate.target is not None
    grasp = candidate.query.grasp(candidate.thing.name)
    if grasp is None:
        raise refused(
            f"how {candidate.arm.name} holds {candidate.thing.name} is not known", "let go of it, and take it again"
        )
    pose = geometry.compose(candidate.target.module_frame.pose, geometry.inverse(grasp)).tolist()
    relies_on = (f"{candidate.thing.name}.grasp", f"{candidate.target.name}.frame")
    return Anchor(pose=pose, frame=candidate.target.name, grasp=grasp.tolist(), relies_on=relies_on)


def stated_seat(program: ElaboratorProgram, values: list[Any], thing: Thing, query: WorldQuery) -> dict[str, Any]:
    """The pose of an object seated in the named seat."""
    seats = [seat.name for seat in query.cell.seats]
    if values[0] not in seats:
        raise suggestions.unknown("seat", values[0], seats, where=values[0])
    refuse_held(program, thing.name, query)
    return {f"{thing.name}.frame": query.seated_pose(values[0]).tolist()}


def taken_along(steps: list[Step], candidate: TaskCandidate) -> list[Step]:
    """The steps of a script; the first motion of a RETRACT, say, states in its result what goes with the hand out of a
    seat, if the sentence does not name it."""
    query = candidate.query
    held = query.holding(candidate.arm.name) if candidate.hand is not None and candidate.thing is None else ""
    inside = (query.seat(held) or query.seat_around(held)) if held else ""
    moving = next((n for n, step in enumerate(steps) if step.to), None)
    if not inside or moving is None:
        return steps
    says = f"{held}, which is in {inside}, goes with the hand"
    stated = msgspec.structs.replace(steps[moving], says="; ".join(filter(None, (steps[moving].says, says))))
    return [*steps[:moving], stated, *steps[moving + 1 :]]
