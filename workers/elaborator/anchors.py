"""Plan anchors by registered name: grasp point, destination, stowed posture, seat. Pure.

An anchor is joint values or a tcp pose. The pose is in an object's frame if it depends on that object. So it can be
bound again after the object was found elsewhere. An anchor that does not exist is refused.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from msgspec.structs import replace

from rtc.language.hands import hand_in_words
from rtc.protocol.advice import fill_in
from rtc.spatial import geometry
from workers.mechanisms import joined
from workers.planning import suggestions
from workers.tasks.anchor import Anchor, named, no_grasp_point, refused
from workers.tasks.candidate import TaskCandidate


def stow(candidate: TaskCandidate) -> Anchor:
    return Anchor(joints=candidate.arm.stow_rad)


def destination(candidate: TaskCandidate) -> Anchor:
    """The destination of MOVE ... TO."""
    place = candidate.parsed.place
    if place is None:
        return _before(candidate)
    if place.joints is not None:
        wanted = len(candidate.arm.joints)
        if len(place.joints) != wanted:
            raise refused(
                f"{candidate.arm.name} has {wanted} joints, {len(place.joints)} were given", f"give {wanted} values"
            )
        slides = [n for n, value in enumerate(candidate.arm.home_deg) if isinstance(value, str)]
        if slides != place.sliding:
            raise refused(
                _wrong_units(candidate, slides, place.sliding), "give each joint its unit, such as 0.5 M 30 DEG"
            )
        return Anchor(joints=list(place.joints))
    if place.position is not None:  # the attitude is kept
        here = candidate.query.tcp(candidate.arm.name)
        return Anchor(pose=geometry.make_pose(place.position, here[3:]).tolist())
    if place.neighborhood_of is not None or place.grasp_point_of is not None:
        return _at_object(
            candidate, place.neighborhood_of or place.grasp_point_of or "", near=place.grasp_point_of is None
        )
    return named(candidate, place.name or "")


def _before(candidate: TaskCandidate) -> Anchor:
    """The tcp pose at which the held object is clear before the target seat, in the seat's frame."""
    figures, inside = candidate.figures, ANCHORS["seat"](candidate)
    assert candidate.target is not None
    assert inside.pose is not None
    out_m = figures["seat_depth_m"] + figures.get("clear_m", 0.0) + figures["held_unsure_m"]
    return replace(inside, pose=geometry.translate(inside.pose, out_m * np.asarray(candidate.target.way_out)).tolist())


def here(candidate: TaskCandidate) -> Anchor:
    """The tcp pose when the command is planned (world frame)."""
    arm = candidate.arm.name
    if not candidate.query.trusts(f"{arm}.joints"):
        clears = fill_in(candidate.program.clears.get("stands", []), {"arm": hand_in_words(arm)})
        raise refused(f"it is not certain where {arm} stands", clears)
    return Anchor(pose=candidate.query.tcp(arm).tolist())


def _wrong_units(candidate: TaskCandidate, slides: list[int], lengths: list[int]) -> str:
    arm = candidate.arm
    wrong = next(n for n in range(len(arm.joints)) if (n in slides) != (n in lengths))
    return f"{arm.joints[wrong]} of {arm.name} {'slides: its value is a length' if wrong in slides else 'turns'}"


def _at_object(candidate: TaskCandidate, name: str, near: bool) -> Anchor:
    thing = suggestions.part(candidate.query.cell.objects, name, "object")
    if not thing.grasp_points:
        raise no_grasp_point(name)
    base = candidate.arm.base.pose
    frame = candidate.query.frame(name)
    points = [geometry.compose(frame, p.frame.pose) for p in thing.grasp_points]
    nearest = min(range(len(points)), key=lambda n: geometry.distance(base, points[n]))
    pose = thing.grasp_points[nearest].frame.pose
    back_m = min(candidate.figures["approach_m"], candidate.figures["neighborhood_radius_m"]) if near else 0.0
    start = geometry.compose(pose, (0.0, 0.0, -back_m, 0.0, 0.0, 0.0, 1.0))
    return Anchor(pose=start.tolist(), frame=name, relies_on=(f"{name}.frame",))


ANCHORS: dict[str, Callable[[TaskCandidate], Anchor]] = {
    "destination": destination,
    "stow": stow,
    "here": here,
    **joined(lambda mechanism: mechanism.anchors),
}
