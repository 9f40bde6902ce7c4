"""Plan anchors by registered name: grasp point, destination, stowed posture, seat. Pure.

An anchor is joint values or a tcp pose. The pose is in an object's frame if it depends on that object. So it can be
bound again after the object was found elsewhere. An anchor that does not exist is refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
import numpy as np
from msgspec.structs import replace

from rtc.language.hands import hand_in_words
from rtc.model.cells import parts
from rtc.protocol import causes
from rtc.protocol.advice import ANOTHER_ARM, Advice, by_person, fill_in
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial import geometry, hinges
from rtc.spatial.geometry import Array
from workers.elaborator.task_candidate import TaskCandidate
from workers.planning import suggestions
from workers.planning.world_query import WorldQuery

ALONG_BAR = (1.0, 0.0, 0.0)  # tool x
ALONG_BOLT = (0.0, 0.0, 1.0)  # z of the tip of a spindle


class Anchor(msgspec.Struct, frozen=True):
    """Joint values (rad), or a tcp pose in `frame` (an object or seat; None = world). `grasp`: pose of the held object
    in the hand that it was made for; with another one the tcp must go elsewhere. `relies_on`: keys of the facts used.
    """

    joints: list[float] | None = None
    pose: list[float] | None = None
    frame: str | None = None
    grasp: list[float] | None = None
    relies_on: tuple[str, ...] = ()


def grasp_point(candidate: TaskCandidate) -> Anchor:
    """The tcp pose at the grasp point, in the object's frame."""
    assert candidate.thing is not None
    if candidate.point is None:
        raise _no_grasp_point(candidate.thing.name)
    pose = candidate.point.frame.pose
    if candidate.point.round:
        at = geometry.compose(candidate.query.frame(candidate.thing.name), pose)
        home = candidate.query.model.arms[candidate.arm.name].fk(candidate.arm.home_rad)
        pose = hinges.turned(pose, ALONG_BAR, hinges.angle_of(at, ALONG_BAR, home))
    return Anchor(
        pose=pose.tolist(),
        frame=candidate.thing.name,
        relies_on=(f"{candidate.thing.name}.frame",),
    )


def stow(candidate: TaskCandidate) -> Anchor:
    return Anchor(joints=candidate.arm.stow_rad)


def seat(candidate: TaskCandidate) -> Anchor:
    """The tcp pose at which the held object is seated in the target seat."""
    assert candidate.thing is not None
    assert candidate.target is not None
    grasp = candidate.query.grasp(candidate.thing.name)
    if grasp is None:
        raise _state(
            f"how {candidate.arm.name} holds {candidate.thing.name} is not known", "let go of it, and take it again"
        )
    pose = geometry.compose(candidate.target.module_frame.pose, geometry.inverse(grasp)).tolist()
    return Anchor(
        pose=pose,
        frame=candidate.target.name,
        grasp=grasp.tolist(),
        relies_on=(f"{candidate.thing.name}.grasp", f"{candidate.target.name}.frame"),
    )


def hinge(candidate: TaskCandidate) -> Anchor:
    """A pose on the hinge of the object, in the object's frame: its z is the axis."""
    assert candidate.thing is not None
    name, hinge = candidate.thing.name, candidate.thing.hinge
    if hinge is None:
        raise _state(f"{name} has no hinge", "an object that has a hinge")
    pose = hinges.frame(geometry.IDENTITY, hinge.axis).tolist()
    return Anchor(pose=pose, frame=name, relies_on=(f"{name}.frame", f"{name}.angle"))


def bolt(candidate: TaskCandidate) -> Anchor:
    """The tcp pose at which the spindle of the held driver is on the head of the bolt, in the bolt's frame.

    A bolt may be turned from any side: the hand keeps the attitude nearest to that of its home."""
    name, grasp, pose = _on_head(candidate)
    driver = candidate.query.holding(candidate.arm.name)
    relies_on = (f"{driver}.grasp", f"{name}.frame")
    return Anchor(pose=pose.tolist(), frame=name, grasp=grasp.tolist(), relies_on=relies_on)


def bolt_out(candidate: TaskCandidate) -> Anchor:
    """The same on the head of the bolt when it is out by all its turns, whether it is or not (world frame)."""
    name, grasp, pose = _on_head(candidate)
    thread = candidate.query.thread(name)
    assert thread is not None
    out = geometry.compose(candidate.query.turned_out(name, thread.turns), pose)
    driver = candidate.query.holding(candidate.arm.name)
    return Anchor(pose=out.tolist(), grasp=grasp.tolist(), relies_on=(f"{driver}.grasp",))


def _on_head(candidate: TaskCandidate) -> tuple[str, Array, Array]:
    """The bolt, the grasp of the driver, and the tcp pose on the head in the bolt's frame."""
    assert candidate.thing is not None
    name, query = candidate.thing.name, candidate.query
    driver = query.driver(candidate.arm.name)
    grasp = query.grasp(driver.name) if driver is not None else None
    if candidate.thing.thread is None or driver is None or driver.spindle is None or grasp is None:
        raise _state(f"{candidate.arm.name} cannot turn {name}", "an object with a thread, and a driver in the hand")
    tip = geometry.compose(grasp, driver.spindle.frame.pose)
    facing = geometry.from_rpy((0.0, 0.0, 0.0), (math.pi, 0.0, 0.0))  # the axes of tip and bolt are opposed
    home = query.model.arms[candidate.arm.name].fk(candidate.arm.home_rad)
    angle = hinges.angle_of(geometry.compose(query.frame(name), facing), ALONG_BOLT, geometry.compose(home, tip))
    return name, grasp, geometry.compose(hinges.turned(facing, ALONG_BOLT, angle), geometry.inverse(tip))


def destination(candidate: TaskCandidate) -> Anchor:
    """The destination of MOVE ... TO."""
    place = candidate.parsed.place
    if place is None:
        return _before(candidate)
    if place.joints is not None:
        wanted = len(candidate.arm.joints)
        if len(place.joints) != wanted:
            raise _state(
                f"{candidate.arm.name} has {wanted} joints, {len(place.joints)} were given", f"give {wanted} values"
            )
        slides = [n for n, value in enumerate(candidate.arm.home_deg) if isinstance(value, str)]
        if slides != place.sliding:
            raise _state(
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
    figures, inside = candidate.figures, seat(candidate)
    assert candidate.target is not None
    assert inside.pose is not None
    out_m = figures["seat_depth_m"] + figures.get("clear_m", 0.0) + figures["held_unsure_m"]
    return replace(inside, pose=geometry.translate(inside.pose, out_m * np.asarray(candidate.target.way_out)).tolist())


def meeting(candidate: TaskCandidate) -> Anchor:
    """The pose of the first arm at the place where the second one takes the object."""
    assert candidate.meeting is not None
    return named(candidate, candidate.meeting.name)


def here(candidate: TaskCandidate) -> Anchor:
    """The tcp pose when the command is planned (world frame)."""
    arm = candidate.arm.name
    if not candidate.query.trusts(f"{arm}.joints"):
        clears = fill_in(candidate.program.clears.get("stands", []), {"arm": hand_in_words(arm)})
        raise _state(f"it is not certain where {arm} stands", clears)
    return Anchor(pose=candidate.query.tcp(arm).tolist())


def _wrong_units(candidate: TaskCandidate, slides: list[int], lengths: list[int]) -> str:
    arm = candidate.arm
    wrong = next(n for n in range(len(arm.joints)) if (n in slides) != (n in lengths))
    return f"{arm.joints[wrong]} of {arm.name} {'slides: its value is a length' if wrong in slides else 'turns'}"


def place(query: WorldQuery, name: str) -> parts.Place:
    """The place of the cell, or the taught one, with this name. Raises Refused if there is none."""
    own = next((place for place in query.cell.places if place.name == name), None)
    if (found := own or next((place for place in query.taught_places if place.name == name), None)) is not None:
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


def _at_object(candidate: TaskCandidate, name: str, near: bool) -> Anchor:
    cell = candidate.query.cell
    thing = next((t for t in cell.objects if t.name == name), None)
    if thing is None:
        raise suggestions.unknown("object", name, [t.name for t in cell.objects])
    if not thing.grasp_points:
        raise _no_grasp_point(name)
    base = candidate.arm.base.pose
    frame = candidate.query.frame(name)
    points = [geometry.compose(frame, p.frame.pose) for p in thing.grasp_points]
    nearest = min(range(len(points)), key=lambda n: geometry.distance(base, points[n]))
    pose = thing.grasp_points[nearest].frame.pose
    back_m = min(candidate.figures["approach_m"], candidate.figures["neighborhood_radius_m"]) if near else 0.0
    start = geometry.compose(pose, (0.0, 0.0, -back_m, 0.0, 0.0, 0.0, 1.0))
    return Anchor(pose=start.tolist(), frame=name, relies_on=(f"{name}.frame",))


def _no_grasp_point(thing: str) -> Refused:
    return Refused.because(
        RefusalReason.NAME,
        f"{thing} has no grasp point",
        where=thing,
        clears="an object that has grasp points, or a grasp point for it in the cell",
    )


def _state(message: str, clears: str | Advice) -> Refused:
    return Refused.because(RefusalReason.STATE, message, clears=clears)


ANCHORS: dict[str, Callable[[TaskCandidate], Anchor]] = {
    "grasp_point": grasp_point,
    "destination": destination,
    "stow": stow,
    "seat": seat,
    "hinge": hinge,
    "meeting": meeting,
    "here": here,
    "bolt": bolt,
    "bolt_out": bolt_out,
}
