"""A grip in a script: whether a hand is empty or holds an object, and the grasp point that it goes to. Pure."""

from __future__ import annotations

import math

from rtc.programs.schema import ScriptFile
from rtc.protocol.messages import Validity, WorldChange
from rtc.spatial import geometry, hinges
from workers.planning.world_query import WorldQuery
from workers.tasks.anchor import Anchor, no_grasp_point
from workers.tasks.candidate import TaskCandidate
from workers.tasks.unmet import UnmetPrecondition

IN_HAND_M = 0.06  # maximum distance of a held object's grasp point from the middle between the fingers
WIDER_M = 0.006  # fingers wider than the object by more than this do not hold it
ALONG_BAR = (1.0, 0.0, 0.0)  # tool x
LET_GO = "let_go"  # effect of a step that opens the hand


def figures(candidate: TaskCandidate) -> dict[str, float]:
    """How wide the object is between the fingers, what it weighs, and whether another hand has it."""
    thing, found = candidate.thing, {}
    if candidate.between is not None:
        found["grasp_width_m"] = candidate.between.width_m
    if thing is not None:
        hand, holder = candidate.hand, candidate.query.held_by(thing.name)
        found["mass_kg"] = float(candidate.query.world.value(f"{thing.name}.mass") or thing.mass_kg)
        found["held_elsewhere"] = float(hand is not None and holder not in ("", hand.name))
    return found


def hand_empty(candidate: TaskCandidate) -> UnmetPrecondition | None:
    """The hand holds nothing."""
    held = candidate.query.holding(candidate.arm.name)
    return UnmetPrecondition(f"{candidate.arm.name} holds {held}", held) if held else None


def object_free(candidate: TaskCandidate) -> UnmetPrecondition | None:
    """The object is not fixed, and no hand holds it or may hold it."""
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


def object_held(candidate: TaskCandidate) -> UnmetPrecondition | None:
    """The hand holds the object, or is the second of two that hold it."""
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


def width_known(candidate: TaskCandidate) -> UnmetPrecondition | None:
    """It is known how wide the hand is open."""
    arm = candidate.arm.name
    known = candidate.query.trusts(f"{arm}.hand_width")
    return None if known else UnmetPrecondition(f"it is not known how wide the hand of {arm} is open", arm)


def let_go_of(script: ScriptFile, candidate: TaskCandidate) -> tuple[str, str] | None:
    """That the object was let go of where the sentence says before the script begins, and the row of `needs`."""
    query, thing, target, partner = candidate.query, candidate.thing, candidate.target, candidate.partner
    if thing is None or not any(step.words.get("effect") == LET_GO for step in script.steps):
        return None
    name, holder, row = thing.name, query.held_by(thing.name), "let_go_already"
    if partner is not None:
        return (f"{partner.name} holds {name} already", row) if holder == partner.name else None
    if holder or query.holding(candidate.arm.name):
        return None
    if target is None:
        return f"{name} is not held", row
    return (f"{name} is in {target.name} already, and not held", row) if query.seat(name) == target.name else None


def grasp_point(candidate: TaskCandidate) -> Anchor:
    """The tcp pose at the grasp point, in the object's frame."""
    assert candidate.thing is not None
    name = candidate.thing.name
    if candidate.point is None:
        raise no_grasp_point(name)
    pose = candidate.point.frame.pose
    if candidate.point.round:
        at = geometry.compose(candidate.query.frame(name), pose)
        home = candidate.query.model.arms[candidate.arm.name].fk(candidate.arm.home_rad)
        pose = hinges.turned(pose, ALONG_BAR, hinges.angle_of(at, ALONG_BAR, home))
    return Anchor(pose=pose.tolist(), frame=name, relies_on=(f"{name}.frame",))


def verified(candidate: TaskCandidate, query: WorldQuery) -> list[WorldChange]:
    """What the sentences after a check of the grip are planned with."""
    held = query.holding(candidate.arm.name)
    keys = [f"{held}.grasp", f"{held}.frame"] if held else []
    return [WorldChange(key=key, keep_value=True, validity=Validity.VALID) for key in keys]
