"""World changes of a successful step beyond the arm's position: objects taken, released or located. Pure.

Registered under the name used in scripts (`effect: taken`). Changes of a step that a halt interrupted are suspect.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from rtc.protocol.messages import Validity, WorldChange
from rtc.spatial import geometry
from rtc.world.spread import widened
from workers.analyzer import touch
from workers.mechanisms import joined
from workers.planning import shared_hold
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import AnalyzeTask
from workers.tasks.flat_grip import Found

Changes = list[WorldChange]

IN_SEAT_M = 0.02  # maximum distance from the seated pose at which RELEASE accepts that an object is in a seat
CATCHES_M = 0.005  # maximum distance from the seated pose at which a catch holds a released object


def taken(task: AnalyzeTask, validity: Validity) -> Changes:
    """The hand holds the object; the finger measurement corrects its frame.

    Along the closing axis the grasp point is centred between the fingers (R149). The other axes keep their uncertainty;
    those of a free object become more uncertain.
    """
    context = task.context
    thing, arm = context.object, task.arm
    if task.query.held_by(thing) not in ("", arm):  # the second hand: the facts of the object refer to the first one
        return [WorldChange(key=f"{arm}.holding", value=thing, validity=validity)]
    frame, spread = touch.between_fingers(task, touch.moved_by_closing(task.query, thing))
    if task.query.hinge(thing) is not None:
        point = task.point.frame.pose[:3]
        frame = task.query.hung(thing, point, geometry.transform_point(frame, point))
    grasp = geometry.normalise(geometry.relative(task.report.tcp_pose, frame))
    return [
        WorldChange(key=f"{arm}.holding", value=thing, validity=validity),
        WorldChange(key=f"{thing}.held_by", value=arm, validity=validity),
        WorldChange(key=f"{thing}.grasp", value=grasp.tolist(), validity=validity, spread=spread),
        WorldChange(key=f"{thing}.frame", value=frame.tolist(), validity=validity, spread=spread),
        *_its_seat(task, touch.seat_of(task, frame, spread), validity),
    ]


def perhaps_taken(task: AnalyzeTask) -> Changes:
    """The hand was closing when its report was lost: the object may be in it, where it was believed to be."""
    thing, arm, doubt = task.context.object, task.arm, Validity.SUSPECT
    if task.query.held_by(thing) not in ("", arm):
        return [WorldChange(key=f"{arm}.holding", value=thing, validity=doubt)]
    frame = task.query.frame(thing)
    grasp = geometry.normalise(geometry.relative(task.query.tcp(arm), frame))
    spread = widened(task.query.spread(f"{thing}.frame"), touch.moved_by_closing(task.query, thing))
    return [
        WorldChange(key=f"{arm}.holding", value=thing, validity=doubt),
        WorldChange(key=f"{thing}.held_by", value=arm, validity=doubt),
        WorldChange(key=f"{thing}.grasp", value=grasp.tolist(), validity=doubt, spread=spread),
        WorldChange(key=f"{thing}.frame", keep_value=True, validity=doubt),
    ]


def _its_seat(task: AnalyzeTask, found: Found | None, validity: Validity) -> Changes:
    if found is None:
        return []
    key = f"{task.query.seat(task.context.object)}.frame"
    return [WorldChange(key=key, value=found[0].tolist(), validity=validity, spread=found[1])]


def felt(task: AnalyzeTask, validity: Validity) -> Changes:
    """The hand touched the object earlier or later than expected: its frame shifts along the search direction."""
    return _seen(task, touch.touched(task), validity)


def tilted(task: AnalyzeTask, validity: Validity) -> Changes:
    """The hand touched the same surface elsewhere along the bar: the object turns about the first touch."""
    return _seen(task, touch.tilted(task), validity)


def pinched(task: AnalyzeTask, validity: Validity) -> Changes:
    """The fingers pressed on the object without holding it: the measurement corrects its position and attitude."""
    return _seen(task, touch.between_fingers(task), validity)


def passed(task: AnalyzeTask, validity: Validity) -> Changes:
    """A search ended without contact: the object may be beyond its end."""
    return _seen(task, touch.beyond(task), validity)


def landed(task: AnalyzeTask, validity: Validity) -> Changes:
    """One finger touched the object from the front: the object is displaced to that finger's side."""
    found = touch.beside(task)
    return [] if found is None else _seen(task, found, validity)


def _seen(task: AnalyzeTask, found: Found, validity: Validity) -> Changes:
    frame, spread = found
    key = f"{task.context.object}.frame"
    return [WorldChange(key=key, value=frame.tolist(), validity=validity, spread=spread)]


def let_go(task: AnalyzeTask, validity: Validity) -> Changes:
    """The fingers are open; the object stays in place, in its seat if the step placed it there."""
    context = task.context
    changes = shared_hold.let_go(task.query, task.arm, context.object)
    if task.query.sharers(task.arm):  # another hand holds it where it is
        return changes
    seat = task.step.words.seat
    if seat:
        changes.append(WorldChange(key=f"{context.object}.seat", value=seat, validity=validity))
        frame, spread = touch.set_down(task.query, context.object, seat)
        key = f"{context.object}.frame"
        return [*changes, WorldChange(key=key, value=frame.tolist(), validity=validity, spread=spread)]
    if task.query.hinge(context.object) is not None:  # its hinge holds it
        return changes
    near, off_m = _nearest_seat(task.query, context.object)
    if off_m > CATCHES_M:
        changes.append(WorldChange(key=f"{context.object}.frame", keep_value=True, validity=Validity.SUSPECT))
    if off_m < IN_SEAT_M and task.query.seat(context.object) != near:  # probably seated; a tug has not tested it
        changes.append(WorldChange(key=f"{context.object}.seat", value=near, validity=Validity.SUSPECT))
    return changes


def let_drift(task: AnalyzeTask, validity: Validity) -> Changes:
    """The fingers are open and nothing holds the object: its frame is suspect."""
    context = task.context
    changes = shared_hold.let_go(task.query, task.arm, context.object)
    if task.query.sharers(task.arm):
        return changes
    return [
        *changes,
        WorldChange(key=f"{context.object}.seat", value=""),
        WorldChange(key=f"{context.object}.frame", keep_value=True, validity=Validity.SUSPECT),
    ]


def _nearest_seat(query: WorldQuery, thing: str) -> tuple[str, float]:
    """The seat with the nearest seated pose, and the object's distance (m) from it; "" without a seat."""
    places = ((geometry.distance(query.frame(thing), query.seated_pose(s.name)), s.name) for s in query.cell.seats)
    off_m, name = min(places, default=(math.inf, ""))
    return name, off_m


def still_held(task: AnalyzeTask, validity: Validity) -> Changes:
    return []


def verified(task: AnalyzeTask, validity: Validity) -> Changes:
    """The fingers press at the object's width: the hand still holds the object.

    Its pose in the hand is not measured: it keeps its uncertainty, which a failure by contact has increased.
    """
    thing, arm = task.context.object, task.arm
    if task.query.held_by(thing) not in ("", arm):  # the second of two hands
        return [WorldChange(key=f"{arm}.holding", value=thing, validity=validity)]
    frame = task.query.in_hand(thing, task.report.tcp_pose)
    if frame is None:
        return []
    turned = task.query.grasp_after(thing, frame, task.report.tcp_pose)
    return [
        WorldChange(key=f"{arm}.holding", value=thing, validity=validity),
        WorldChange(key=f"{thing}.held_by", value=arm, validity=validity),
        WorldChange(key=f"{thing}.grasp", value=turned, keep_value=turned is None, validity=validity),
        WorldChange(key=f"{thing}.frame", value=geometry.normalise(frame).tolist(), validity=validity),
    ]


def pointed(task: AnalyzeTask, validity: Validity) -> Changes:
    """The operator has brought the hand to the grasp point: the object is where the hand shows it (R149)."""
    found = touch.at_grasp_point(task, task.values["pointed_m"], task.values["pointed_rad"])
    return _seen(task, found, validity)


EFFECTS: dict[str, Callable[[AnalyzeTask, Validity], Changes]] = {
    "taken": taken,
    "let_go": let_go,
    "let_drift": let_drift,
    "still_held": still_held,
    "verified": verified,
    "felt": felt,
    "tilted": tilted,
    "pinched": pinched,
    "passed": passed,
    "landed": landed,
    "pointed": pointed,
    **joined(lambda mechanism: mechanism.effects),
}
