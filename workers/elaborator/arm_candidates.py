"""Candidates for a command: the arms, objects, grasp points and seats that its sentence allows."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import msgspec

from rtc.language.hands import hand_in_words
from rtc.model.cells import cell as cells
from rtc.model.cells import parts
from rtc.programs.schema import OWN, ElaboratorProgram
from rtc.protocol.advice import by_sentence
from rtc.protocol.outcomes import Refusal, Refused
from rtc.protocol.sentence import BOTH_ARMS, Destination, ParsedCommand
from rtc.spatial import geometry
from rtc.world.model import BOLT_STATES
from workers.elaborator.figures import with_figures
from workers.mechanisms import each
from workers.planning import suggestions
from workers.tasks.candidate import AskedTask, TaskCandidate, lets_go_first
from workers.tasks.command_fields import fits_sentence

ARMS, PARTNERS = each(lambda mechanism: mechanism.arms), each(lambda mechanism: mechanism.partners)
POINTS = each(lambda mechanism: mechanism.points)


def candidates(asked: AskedTask) -> list[TaskCandidate]:
    """One candidate per arm and grasp point that the sentence allows. The points of the first grasp planner that the
    program names come first; those of one, nearest first. Raises Refused."""
    thing, asked = _thing(asked), _with_place(asked)
    program, parsed, query = asked.program, asked.parsed, asked.query
    seated = parsed.target not in (None, *BOLT_STATES)
    target = suggestions.part(query.cell.seats, parsed.target or "", "seat") if seated else None
    arms, points = _arms(asked, thing), _points(asked, thing)
    allowed = []
    for arm in arms:
        about = thing or _shared(asked, arm)
        pairs = [pair for partners in PARTNERS for pair in partners(asked, arm)] or [(None, None)]
        for (partner, meeting), point in itertools.product(pairs, points):
            made = TaskCandidate(
                query, program, parsed, asked.limits, arm, about, point, target, {}, None, None, partner, meeting
            )
            allowed.append(with_figures(made))
    return sorted(allowed, key=lambda one: (_rank(program, one.point), _far(one)))


def _with_place(asked: AskedTask) -> AskedTask:
    """The sentence, with its target as the destination if it is a place and a script of the verb goes to places.

    Raises Refused for a target that is neither a seat nor a place."""
    query, target = asked.query, asked.parsed.target
    if target is None or target in (seats := [seat.name for seat in query.cell.seats]):
        return asked
    if not {"place", "target"} <= {name for script in asked.of_verb for name in script.uses}:
        return asked
    places = [place.name for place in query.places]
    if target not in places:
        raise suggestions.unknown("place or seat", target, [*places, *seats])
    return asked._replace(parsed=msgspec.structs.replace(asked.parsed, target=None, place=Destination(name=target)))


def _thing(asked: AskedTask) -> parts.Object | None:
    """The object of the sentence. Raises Refused; if the verb also takes a hand alone, arms are expected as well."""
    parsed, cell = asked.parsed, asked.query.cell
    if parsed.object is None:
        return None
    try:
        return suggestions.part(cell.objects, parsed.object, "object")
    except Refused as unknown:
        hands = any(check.missing == "object" for row in asked.program.branches[parsed.verb] for check in row.when)
        if parsed.hand is not None or not hands:
            raise
        raise _neither_object_nor_hand(unknown.refusal, parsed, cell) from None


def _shared(asked: AskedTask, arm: parts.Arm) -> parts.Object | None:
    """What this arm and another one hold, for a verb with a script that lets go of it first; None without one."""
    query = asked.query
    if asked.parsed.object is not None or not query.sharers(arm.name):
        return None
    leaves = any(lets_go_first(script, of_object=True) for script in asked.of_verb)
    return query.cell.object(query.holding(arm.name)) if leaves else None


def _neither_object_nor_hand(unknown: Refusal, parsed: ParsedCommand, cell: cells.Cell) -> Refused:
    named = next((arm for arm in cell.arms if parsed.object in (arm.name, arm.end_effector)), None)
    if named is not None:  # a further arm, without its ARM
        clears = by_sentence(f"{parsed.verb} {hand_in_words(named.name)}", instead=True)
        return Refused(msgspec.structs.replace(unknown, nearest=[], clears=clears))
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


def _arms(asked: AskedTask, thing: parts.Object | None) -> list[parts.Arm]:
    """The arm named in the sentence; else those that a mechanism names; else those that hold the object; else all."""
    query, hand = asked.query, asked.parsed.hand
    if hand not in (None, BOTH_ARMS):
        return [suggestions.part(query.cell.arms, hand or "", "arm")]
    able = [name for arms in ARMS for name in arms(asked)]
    holder = query.held_by(thing.name) if thing else ""
    return [arm for arm in query.cell.arms if arm.name in (able or [holder or arm.name])]


def _points(asked: AskedTask, thing: parts.Object | None) -> Sequence[parts.GraspPoint | None]:
    """The grasp point named in the sentence; else those of the grasp planners that the program names, in their order,
    which a mechanism finds of use; [None] if no script of the verb uses a grasp point."""
    program, parsed = asked.program, asked.parsed
    chosen = [asked.scripts[row.script] for row in program.branches[parsed.verb] if fits_sentence(row, parsed)]
    if thing is None or not any("grasp_point" in script.uses for script in chosen):
        return [None]
    if parsed.grasp_point is not None:
        return [suggestions.part(thing.grasp_points, parsed.grasp_point, "grasp point", of=thing.name)]
    ranked = sorted(thing.grasp_points, key=lambda point: _rank(program, point))
    points = [point for point in ranked if (point.planner or OWN) in program.grasp_planners]
    for of_use in POINTS:
        points = of_use(asked, points)
    return points or [None]


def _rank(program: ElaboratorProgram, point: parts.GraspPoint | None) -> int:
    """The place of its grasp planner in the program; one that only the sentence names has no rival."""
    planner, named = (point.planner if point else "") or OWN, program.grasp_planners
    return named.index(planner) if planner in named else 0
