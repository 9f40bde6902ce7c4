"""Commands about an object that two hands hold, or that one hands to the other: arms, places, and refusals. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec.structs import replace

from rtc.language.hands import hand_in_words
from rtc.model.cells import parts
from rtc.programs.extension_names import PARTNER
from rtc.programs.schema import ElaboratorProgram, ScriptFile
from rtc.protocol import causes
from rtc.protocol.advice import by_person, by_sentence, fill_in
from rtc.protocol.messages import WorldChange
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.sentence import BOTH_ARMS
from rtc.spatial import geometry
from workers.mechanisms.mechanism import Partner
from workers.planning import shared_hold, suggestions
from workers.planning.world_query import WorldQuery
from workers.tasks.anchor import Anchor, named
from workers.tasks.candidate import AskedTask, TaskCandidate, lets_go_first
from workers.tasks.sentence_of import sentence_of
from workers.tasks.unmet import UnmetPrecondition


def arms(asked: AskedTask) -> list[str]:
    """Of BOTH-ARMS the leading one of two that hold one object: the one that the facts of the object refer to. A script
    in which the second hand takes the object needs only this one. Raises Refused."""
    parsed, query = asked.parsed, asked.query
    if parsed.hand != BOTH_ARMS:
        return []
    rows = [row for row in asked.program.decision_tree if any(c.equals.get("hand") == BOTH_ARMS for c in row.when)]
    able = [row.verb for row in rows]
    if parsed.verb not in able:
        message = f"{parsed.verb} has no script for two arms"
        alone = [] if parsed.object else [sentence_of(replace(parsed, hand=arm.name)) for arm in query.cell.arms]
        each = by_sentence(*alone, instead=True) if alone and all(alone) else by_person("name one arm")
        clears = [*each, *by_person(f"{', '.join(dict.fromkeys(able))} can take {BOTH_ARMS}")]
        raise Refused.because(RefusalReason.NO_SCRIPT, message, clears=clears)
    if any(reflex.action != "stop" for reflex in parsed.reflexes):
        message = f"{BOTH_ARMS} can only stop when an UNLESS becomes true: another reflex would pull at the object"
        raise Refused.because(RefusalReason.NO_SCRIPT, message, clears="THEN STOP")
    holder = query.held_by(parsed.object) if parsed.object else ""
    if holder and any(_takes(asked.scripts[row.script]) for row in rows if row.verb == parsed.verb):
        return [holder]
    sharing = [arm.name for arm in query.cell.arms if query.sharers(arm.name)]
    if leading := [arm for arm in sharing if query.held_by(query.holding(arm)) == arm]:
        return leading[:1]
    raise _unshared(asked.program, query, parsed.object or "")


def _unshared(program: ElaboratorProgram, query: WorldQuery, thing: str) -> Refused:
    """The refusal of BOTH-ARMS without a common object; it states the sentence with which the next hand takes it.

    `thing`: the object of the sentence; empty without one."""
    held = {arm.name: query.holding(arm.name) for arm in query.cell.arms}
    message = f"{BOTH_ARMS} must hold one object; " + ", ".join(
        f"{arm} holds {name or 'nothing'}" for arm, name in held.items()
    )
    clears = program.needs.get("both_hands", [])
    first = next((name for name in held.values() if name), "")
    if thing and not first:
        clears = [*fill_in(program.needs.get("object_held", []), {"object": thing}), *clears]
    empty = next((arm for arm in query.cell.arms if not held[arm.name]), None)
    free = shared_hold.free_points(query, first) if first else []
    if free and empty is not None:
        texts = {"held": first, "free": free[0], "hand": hand_in_words(empty.name)}
        clears = fill_in(program.needs.get("second_hand", []), texts)
    cause = causes.NeedUnmet(need="both_hands", by=first)
    return Refused.because(RefusalReason.STATE, message, clears=clears, cause=cause)


def _takes(script: ScriptFile) -> bool:
    """Whether the second hand takes the object in this script."""
    return any(step.who == PARTNER and step.words.get("effect") == "taken" for step in script.steps)


def partners(asked: AskedTask, arm: parts.Arm) -> Iterator[Partner]:
    """The second arms of the sentence, each with the places where it may take what `arm` holds; none if the sentence is
    about one arm. None in the place of a place: where the object is."""
    query, parsed = asked.query, asked.parsed
    sharing = query.sharers(arm.name)
    if parsed.to_hand is not None:
        named = [parsed.to_hand]
    elif parsed.hand == BOTH_ARMS:
        named = sharing[:1] or [other.name for other in query.cell.arms if other.name != arm.name]
    else:
        return
    goal = parsed.place.name if parsed.place else None
    for name in named:
        second = suggestions.part(query.cell.arms, name, "arm")
        yield second, None
        if name not in sharing:  # the places that both have a pose for are those where two arms can meet
            meetings = (place for place in query.places if {arm.name, name} <= place.poses.keys())
            yield from ((second, place) for place in meetings if place.name != goal)


def free_points(asked: AskedTask, points: list[parts.GraspPoint]) -> list[parts.GraspPoint]:
    """The grasp points where no hand holds the object, unless there are none."""
    free = shared_hold.free_points(asked.query, asked.parsed.object or "")
    return [point for point in points if point.name in free] or points


def refuse_moving_alone(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse to move one arm whose object another arm holds too. An arm that lets go of it first may move."""
    if candidate.hand is None or lets_go_first(script) or not any(step.to for step in script.steps):
        return
    second = candidate.partner.name if candidate.partner else ""
    shared_hold.refuse_alone(candidate.query, candidate.arm.name, second, candidate.program.clears)


def figures(candidate: TaskCandidate) -> dict[str, float]:
    """Whether two hands hold the object, and whether there is a place where both arms meet."""
    return {"shared": float(_is_shared(candidate)), "meets": float(candidate.meeting is not None)}


def _is_shared(candidate: TaskCandidate) -> bool:
    """By the second hand of the command, or without one by any other hand."""
    query, arm, thing, partner = candidate.query, candidate.hand, candidate.thing, candidate.partner
    if thing is None or arm is None:
        return False
    if partner is not None:
        return query.holding(partner.name) == thing.name
    return query.holding(arm.name) == thing.name and bool(query.sharers(arm.name))


def meeting(candidate: TaskCandidate) -> Anchor:
    """The pose of the first arm at the place where the second one takes the object."""
    assert candidate.meeting is not None
    return named(candidate, candidate.meeting.name)


def other_handle(candidate: TaskCandidate) -> UnmetPrecondition | None:
    """Another hand holds the object, at another grasp point."""
    assert candidate.thing is not None
    name, query = candidate.thing.name, candidate.query
    used = shared_hold.points_in_use(query, name)
    if not used:
        return UnmetPrecondition(f"{name} is not held", name, "object_held")
    free = shared_hold.free_points(query, name)
    if not free:
        holder = next(iter(used))
        return UnmetPrecondition(f"{holder} holds {name} at its only handle", holder, "object_free", name)
    there = next((arm for arm, point in used.items() if candidate.point and point == candidate.point.name), "")
    return UnmetPrecondition(f"{there} holds {name} at {used[there]}", " or ".join(free), thing=name) if there else None


def partner_empty(candidate: TaskCandidate) -> UnmetPrecondition | None:
    """The second hand holds nothing."""
    assert candidate.partner is not None
    arm = candidate.partner.name
    held = candidate.query.holding(arm)
    return UnmetPrecondition(f"{arm} holds {held}", held, "hand_empty") if held else None


def taken(candidate: TaskCandidate, query: WorldQuery) -> list[WorldChange]:
    """What the steps and sentences after a grasp are planned with. The facts of an object are those of its first
    hand."""
    assert candidate.thing is not None
    assert candidate.point is not None
    arm, thing = candidate.arm.name, candidate.thing.name
    grasp = geometry.normalise(geometry.inverse(candidate.point.frame.pose)).tolist()
    return [
        *([] if query.held_by(thing) else shared_hold.held(arm, thing, grasp)),
        WorldChange(key=f"{arm}.holding", value=thing),
        WorldChange(key=f"{arm}.hand_width", value=candidate.point.width_m),
    ]


def let_go(candidate: TaskCandidate, query: WorldQuery) -> list[WorldChange]:
    """What the steps and sentences after a hand has let go are planned with."""
    assert candidate.thing is not None
    arm = candidate.arm.name
    width = WorldChange(key=f"{arm}.hand_width", value=candidate.arm.gripper.max_opening_m)
    return [*shared_hold.let_go(query, arm, candidate.thing.name), width]
