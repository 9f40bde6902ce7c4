"""Candidates for a command: the arms, objects, grasp points and seats that its sentence allows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import msgspec

from rtc.language.hands import hand_in_words
from rtc.model.cells import cell as cells
from rtc.model.cells import parts
from rtc.programs.schema import ElaboratorProgram, ScriptFile
from rtc.protocol.messages import Limits
from rtc.protocol.outcomes import Refusal
from rtc.protocol.sentence import BOTH_ARMS, ParsedCommand
from rtc.spatial import geometry
from workers.elaborator import two_hands
from workers.elaborator.task_candidate import TaskCandidate, figures_of
from workers.planning import suggestions
from workers.planning.world_query import WorldQuery


def candidates(
    program: ElaboratorProgram,
    scripts: Mapping[str, ScriptFile],
    parsed: ParsedCommand,
    limits: Limits,
    query: WorldQuery,
) -> list[TaskCandidate] | Refusal:
    """One candidate per arm and grasp point that the sentence allows, nearest first."""
    cell = query.cell
    thing: parts.Object | None = None
    if parsed.object is not None:
        found = _part(cell.objects, parsed.object, "object")
        if isinstance(found, Refusal):
            return _or_a_hand(found, program, parsed, cell)
        thing = found
    target: parts.Seat | None = None
    if parsed.target is not None:
        seat = _part(cell.seats, parsed.target, "seat")
        if isinstance(seat, Refusal):
            return seat
        target = seat
    arms = _arms(program, parsed, query, thing)
    points = arms if isinstance(arms, Refusal) else _points(program, scripts, parsed, thing)
    if isinstance(arms, Refusal) or isinstance(points, Refusal):
        return arms if isinstance(arms, Refusal) else points  # type: ignore[return-value]
    allowed = []
    for arm in arms:
        for point in two_hands.free_points(query, parsed, thing, points):
            figures = figures_of(program, parsed, query, arm, thing, point, target)
            if isinstance(figures, Refusal):
                return figures
            partner = two_hands.partner(query, arm) if parsed.hand == BOTH_ARMS else None
            allowed.append(
                TaskCandidate(query, program, parsed, limits, arm, thing, point, target, figures, partner=partner)
            )
    return sorted(allowed, key=_far)


def _or_a_hand(unknown: Refusal, program: ElaboratorProgram, parsed: ParsedCommand, cell: cells.Cell) -> Refusal:
    """Refusal for an unknown object. If the verb also takes a hand without an object, arms are expected as well."""
    takers = [row for row in program.decision_tree if row.verb == parsed.verb]
    hands = any(check.missing == "object" for row in takers for check in row.when)
    if parsed.hand is not None or not hands:
        return unknown
    named = next((arm for arm in cell.arms if parsed.object in (arm.name, arm.end_effector)), None)
    if named is not None:  # a further arm, without its ARM
        clears = f"{parsed.verb} {hand_in_words(named.name)}"
        return msgspec.structs.replace(unknown, nearest=[], clears=clears)
    alone = [arm.end_effector for arm in cell.arms if hand_in_words(arm.name) == arm.name]  # written without ARM
    known = [*unknown.expected, *(hand_in_words(arm.name) for arm in cell.arms), *alone]
    return suggestions.unknown("object or hand", parsed.object or "", known)


def _far(candidate: TaskCandidate) -> float:
    """Distance (m) from the arm's base to its grasp goal; the order in which candidates are tried."""
    if candidate.thing is None:
        return 0.0
    frame = candidate.query.frame(candidate.thing.name)
    goal = geometry.compose(frame, candidate.point.frame.pose) if candidate.point else frame
    return geometry.distance(candidate.arm.base.pose, goal)


def _arms(
    program: ElaboratorProgram, parsed: ParsedCommand, query: WorldQuery, thing: parts.Object | None
) -> list[parts.Arm] | Refusal:
    """The arm named in the sentence; else the arm that holds the object; else all arms."""
    cell = query.cell
    if parsed.hand is not None:
        if parsed.hand == BOTH_ARMS:
            return two_hands.both_arms(program, parsed, query)
        found = _part(cell.arms, parsed.hand, "arm")
        return found if isinstance(found, Refusal) else [found]
    holder = query.held_by(thing.name) if thing else ""
    return [arm for arm in cell.arms if not holder or arm.name == holder]


def _points(
    program: ElaboratorProgram,
    scripts: Mapping[str, ScriptFile],
    parsed: ParsedCommand,
    thing: parts.Object | None,
) -> list[parts.GraspPoint | None] | Refusal:
    """The grasp point named in the sentence; else all; [None] if no script of the verb uses a grasp point."""
    chosen = [scripts[b.script] for b in program.decision_tree if b.verb == parsed.verb]
    if thing is None or not any("grasp_point" in script.uses for script in chosen):
        return [None]
    if parsed.grasp_point is None:
        return [*thing.grasp_points] or [None]
    found = _part(thing.grasp_points, parsed.grasp_point, f"grasp point of {thing.name}")
    return found if isinstance(found, Refusal) else [found]


T = TypeVar("T", parts.Arm, parts.Object, parts.Seat, parts.GraspPoint)


def _part(choices: list[T], name: str, what: str) -> T | Refusal:
    found = next((part for part in choices if part.name == name), None)
    return found or suggestions.unknown(what, name, [part.name for part in choices])
