"""Anchor of a plan: joint values or a tcp pose, which a step leads to; those of named places. Pure."""

from __future__ import annotations

import msgspec

from rtc.model.cells import parts
from rtc.protocol import causes
from rtc.protocol.advice import ANOTHER_ARM, Advice, by_person
from rtc.protocol.outcomes import RefusalReason, Refused
from workers.planning import suggestions
from workers.planning.world_query import WorldQuery
from workers.tasks.candidate import TaskCandidate

POSE_OF_JOINTS = "/plan"  # suffix of a binding: NAME/plan is the pose from which the joint values NAME were solved


class Anchor(msgspec.Struct, frozen=True):
    """Joint values (rad), or a tcp pose in `frame` (an object or seat; None = world). `grasp`: pose of the held object
    in the hand that it was made for; with another one the tcp must go elsewhere. `relies_on`: keys of the facts used.
    """

    joints: list[float] | None = None
    pose: list[float] | None = None
    frame: str | None = None
    grasp: list[float] | None = None
    relies_on: tuple[str, ...] = ()


def refused(message: str, clears: str | Advice) -> Refused:
    """The refusal of an anchor that does not exist in this state of the world."""
    return Refused.because(RefusalReason.STATE, message, clears=clears)


def place(query: WorldQuery, name: str) -> parts.Place:
    """The place of the cell, or the taught one, with this name. Raises Refused if there is none."""
    if (found := next((place for place in query.places if place.name == name), None)) is not None:
        return found
    if any(thing.name == name for thing in query.cell.objects):
        message = f"{name} is an object: a hand goes TO-NEIGHBORHOOD-OF {name}, or TO-GRASP-POINT-OF {name}"
        raise Refused.because(RefusalReason.NAME, message, nearest=[name], clears="use one of the two forms")
    raise suggestions.unknown("place", name, (place.name for place in query.places))


def named(candidate: TaskCandidate, name: str) -> Anchor:
    """The pose or the joint values of a named place, for this arm."""
    there = place(candidate.query, name)
    joints = there.joints_rad(candidate.arm.name)
    if joints is not None:
        return Anchor(joints=joints)
    frame = there.poses.get(candidate.arm.name)
    if frame is not None:
        return Anchor(pose=frame.pose.tolist())
    able = sorted({*there.poses, *there.joints_deg})
    raise Refused.because(
        RefusalReason.INFEASIBLE,
        f"{candidate.arm.name} has no posture for {name}; {', '.join(able)} can",
        where=name,
        expected=able,
        clears=[ANOTHER_ARM, *by_person(f"a place that {candidate.arm.name} can go to")],
        cause=causes.NoPosture(arm=candidate.arm.name, place=name),
    )


def no_grasp_point(thing: str) -> Refused:
    return Refused.because(
        RefusalReason.NAME,
        f"{thing} has no grasp point",
        where=thing,
        clears="an object that has grasp points, or a grasp point for it in the cell",
    )
