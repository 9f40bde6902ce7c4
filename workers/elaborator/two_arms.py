"""Commands about an object that two hands hold: the arms of BOTH-ARMS, and refusals to move one of them alone. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rtc.language.hands import hand_in_words
from rtc.model.cells import parts
from rtc.programs.extension_names import PARTNER
from rtc.programs.schema import ElaboratorProgram, ScriptFile
from rtc.protocol import causes
from rtc.protocol.advice import by_person, by_sentence, fill_in
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.sentence import BOTH_ARMS, ParsedCommand
from workers.conditions import sharing
from workers.planning import shared_hold, suggestions
from workers.planning.world_query import WorldQuery
from workers.tasks.candidate import TaskCandidate
from workers.tasks.scripts import lets_go_first


def both_arms(
    program: ElaboratorProgram, scripts: Mapping[str, ScriptFile], parsed: ParsedCommand, query: WorldQuery
) -> parts.Arm:
    """The leading arm of two that hold one object: the one that the facts of the object refer to. A script in which the
    second hand takes the object needs only this one. Raises Refused."""
    rows = [row for row in program.decision_tree if any(c.equals.get("hand") == BOTH_ARMS for c in row.when)]
    able = [row.verb for row in rows]
    if parsed.verb not in able:
        message = f"{parsed.verb} has no script for two arms"
        each = by_sentence(*(f"{parsed.verb} {hand_in_words(arm.name)}" for arm in query.cell.arms), instead=True)
        others = by_person(f"{', '.join(dict.fromkeys(able))} can take {BOTH_ARMS}")
        clears = [*(by_person("name one arm") if parsed.object else each), *others]
        raise Refused.because(RefusalReason.NO_SCRIPT, message, clears=clears)
    if any(reflex.action != "stop" for reflex in parsed.reflexes):
        message = f"{BOTH_ARMS} can only stop when an UNLESS becomes true: another reflex would pull at the object"
        raise Refused.because(RefusalReason.NO_SCRIPT, message, clears="THEN STOP")
    holder = query.held_by(parsed.object) if parsed.object else ""
    if holder and any(_takes(scripts[row.script]) for row in rows if row.verb == parsed.verb):
        return query.cell.arm(holder)
    sharing = [arm for arm in query.cell.arms if query.sharers(arm.name)]
    leading = next((arm for arm in sharing if query.held_by(query.holding(arm.name)) == arm.name), None)
    if leading is None:
        raise _unshared(program, query, parsed.object or "")
    return leading


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


def seconds(
    query: WorldQuery, parsed: ParsedCommand, arm: parts.Arm
) -> Iterator[tuple[parts.Arm | None, parts.Place | None]]:
    """The second arms of the sentence, each with the places where it may take what `arm` holds.

    None in the place of an arm: the sentence is about one. None in the place of a place: where the object is."""
    sharing = query.sharers(arm.name)
    if parsed.to_hand is not None:
        named = [parsed.to_hand]
    elif parsed.hand == BOTH_ARMS:
        named = sharing[:1] or [other.name for other in query.cell.arms if other.name != arm.name]
    else:
        yield None, None
        return
    for name in named:
        second = _arm(query, name)
        yield second, None
        if name not in sharing:
            yield from ((second, place) for place in _meetings(query, parsed, arm.name, name))


def _arm(query: WorldQuery, name: str) -> parts.Arm:
    known = {arm.name: arm for arm in query.cell.arms}
    if name not in known:
        raise suggestions.unknown("arm", name, known)
    return known[name]


def _meetings(query: WorldQuery, parsed: ParsedCommand, first: str, second: str) -> list[parts.Place]:
    """The places that both arms have a pose for, except the destination: those of a cell where two arms can meet."""
    goal = parsed.place.name if parsed.place else None
    return [place for place in query.places if {first, second} <= place.poses.keys() and place.name != goal]


def free_points(
    query: WorldQuery, parsed: ParsedCommand, thing: parts.Object | None, points: list[parts.GraspPoint | None]
) -> list[parts.GraspPoint | None]:
    """The grasp points where no hand holds the object, unless there are none or the sentence names one."""
    if thing is None or parsed.grasp_point is not None:
        return points
    free = shared_hold.free_points(query, thing.name)
    return [point for point in points if point is None or point.name in free] or points


def refuse_moving_alone(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse to move one arm whose object another arm holds too. An arm that lets go of it first may move."""
    if candidate.hand is None or lets_go_first(script) or not any(step.to for step in script.steps):
        return
    second = candidate.partner.name if candidate.partner else ""
    sharing.refuse_alone(candidate.query, candidate.arm.name, second, candidate.program.clears)
