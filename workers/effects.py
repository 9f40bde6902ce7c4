"""What a step that succeeded has changed, beyond where the arm is: something was taken, or let go. Pure.

Registered by the name a script gives (`effect: taken`). An effect that a halt cut short is written as suspect.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from rtc import geometry
from rtc.messages import AnalyzerInput, Validity, WorldChange
from workers import feeling
from workers.belief import WorldQuery

Changes = list[WorldChange]

CATCHES_M = 0.005  # further from its seated place than this, no catch takes hold of a thing that is let go


def taken(query: WorldQuery, data: AnalyzerInput, validity: Validity) -> Changes:
    """The hand has the object between its fingers. Where it was believed to be is corrected by what the fingers have
    measured: along the axis they close on, the grasp point is in the middle between them (R149). Of the other axes
    no more is known than before."""
    context = data.evaluation.context
    thing, arm = context.object, context.arm
    frame, spread = feeling.between_fingers(query, data)
    grasp = geometry.normalise(geometry.relative(data.report.tcp_pose, frame))
    return [
        WorldChange(key=f"{arm}.holding", value=thing, validity=validity),
        WorldChange(key=f"{thing}.held_by", value=arm, validity=validity),
        WorldChange(key=f"{thing}.grasp", value=grasp.tolist(), validity=validity, spread=spread),
        WorldChange(key=f"{thing}.frame", value=frame.tolist(), validity=validity, spread=spread),
        *_its_seat(query, data, feeling.seat_of(query, data, frame, spread), validity),
    ]


def _its_seat(query: WorldQuery, data: AnalyzerInput, found: feeling.Found | None, validity: Validity) -> Changes:
    if found is None:
        return []
    key = f"{query.seat(data.evaluation.context.object)}.frame"
    return [WorldChange(key=key, value=found[0].tolist(), validity=validity, spread=found[1])]


def felt(query: WorldQuery, data: AnalyzerInput, validity: Validity) -> Changes:
    """The hand came upon the object sooner or later than expected: so much nearer or farther is the object."""
    return _seen(data, feeling.touched(query, data), validity)


def pinched(query: WorldQuery, data: AnalyzerInput, validity: Validity) -> Changes:
    """The fingers have pressed on the object for a moment, and do not hold it: they tell where and how it stands."""
    return _seen(data, feeling.between_fingers(query, data), validity)


def passed(query: WorldQuery, data: AnalyzerInput, validity: Validity) -> Changes:
    """A search felt nothing all along its way: what it looked for may lie beyond."""
    return _seen(data, feeling.beyond(query, data), validity)


def landed(query: WorldQuery, data: AnalyzerInput, validity: Validity) -> Changes:
    """A finger stands on what was to come between the fingers: it lies to that finger's side."""
    found = feeling.beside(query, data)
    return [] if found is None else _seen(data, found, validity)


def _seen(data: AnalyzerInput, found: feeling.Found, validity: Validity) -> Changes:
    frame, spread = found
    key = f"{data.evaluation.context.object}.frame"
    return [WorldChange(key=key, value=frame.tolist(), validity=validity, spread=spread)]


def let_go(query: WorldQuery, data: AnalyzerInput, validity: Validity) -> Changes:
    """The fingers are open; the object stays where it was, in its seat if it has been brought into one."""
    context = data.evaluation.context
    changes = gone(context.arm, context.object)
    seat = data.evaluation.step.args.get("seat")
    if isinstance(seat, str) and seat:
        changes.append(WorldChange(key=f"{context.object}.seat", value=seat, validity=validity))
    elif _off_m(query, context.object) > CATCHES_M:
        changes.append(WorldChange(key=f"{context.object}.frame", keep_value=True, validity=Validity.SUSPECT))
    return changes


def let_drift(query: WorldQuery, data: AnalyzerInput, validity: Validity) -> Changes:
    """The fingers are open, and nothing holds the object: where it is now, nobody knows."""
    context = data.evaluation.context
    return [
        *gone(context.arm, context.object),
        WorldChange(key=f"{context.object}.seat", value=""),
        WorldChange(key=f"{context.object}.frame", keep_value=True, validity=Validity.SUSPECT),
    ]


def _off_m(query: WorldQuery, thing: str) -> float:
    """How far a thing is from the nearest place where a seat would hold it."""
    places = (query.seated_pose(seat.name) for seat in query.cell.seats)
    return min((geometry.distance(query.frame(thing), place) for place in places), default=math.inf)


def gone(arm: str, thing: str) -> Changes:
    """The hand holds nothing any more."""
    return [
        WorldChange(key=f"{arm}.holding", value=""),
        WorldChange(key=f"{thing}.held_by", value=""),
        WorldChange(key=f"{thing}.grasp", value=None),
    ]


def still_held(query: WorldQuery, data: AnalyzerInput, validity: Validity) -> Changes:
    return []


def verified(query: WorldQuery, data: AnalyzerInput, validity: Validity) -> Changes:
    """The fingers press, and stand as wide as the thing is: it is held as it was believed to be."""
    thing, arm = data.evaluation.context.object, data.evaluation.context.arm
    grasp = query.grasp(thing)
    if grasp is None:
        return []
    frame = geometry.compose(data.report.tcp_pose, grasp)
    return [
        WorldChange(key=f"{arm}.holding", value=thing, validity=validity),
        WorldChange(key=f"{thing}.held_by", value=arm, validity=validity),
        WorldChange(key=f"{thing}.grasp", keep_value=True, validity=validity),
        WorldChange(key=f"{thing}.frame", value=geometry.normalise(frame).tolist(), validity=validity),
    ]


EFFECTS: dict[str, Callable[[WorldQuery, AnalyzerInput, Validity], Changes]] = {
    "taken": taken,
    "let_go": let_go,
    "let_drift": let_drift,
    "still_held": still_held,
    "verified": verified,
    "felt": felt,
    "pinched": pinched,
    "passed": passed,
    "landed": landed,
}
