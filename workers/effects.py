"""What a step that succeeded has changed, beyond where the arm is: something was taken, or let go. Pure.

Registered by the name a script gives (`effect: taken`). An effect that a halt cut short is written as suspect.
"""

from __future__ import annotations

from collections.abc import Callable

from rtc import geometry
from rtc.messages import AnalyzerInput, Validity, WorldChange
from workers import known
from workers.belief import Belief

Changes = list[WorldChange]

CLOSING = 1  # the axis of a grasp point along which fingers close
CENTRED_M = 0.001  # how well that is known of what is between them


def taken(belief: Belief, data: AnalyzerInput, validity: Validity) -> Changes:
    """The hand has the object between its fingers. Where it was believed to be is corrected by what the fingers have
    measured: along the axis they close on, the grasp point is in the middle between them (R149). Of the other axes
    no more is known than before."""
    context, report = data.evaluation.context, data.report
    thing, arm = context.object, context.arm
    point = belief.cell.object(thing).grasp_point(context.grasp_point).frame.pose
    believed = geometry.compose(belief.frame(thing), point)  # of the tcp, had the object been where it was believed
    offset = geometry.relative(report.tcp_pose, believed)
    offset[1] = 0.0
    grasp = geometry.compose(offset, geometry.inverse(point))
    frame = geometry.compose(report.tcp_pose, grasp)
    before = belief.spread(f"{thing}.frame")
    spread = known.felt(belief.frame(thing), frame, before, point, {CLOSING: CENTRED_M})
    return [
        WorldChange(key=f"{arm}.holding", value=thing, validity=validity),
        WorldChange(key=f"{thing}.held_by", value=arm, validity=validity),
        WorldChange(key=f"{thing}.grasp", value=geometry.normalise(grasp).tolist(), validity=validity, spread=spread),
        WorldChange(key=f"{thing}.frame", value=geometry.normalise(frame).tolist(), validity=validity, spread=spread),
    ]


def let_go(belief: Belief, data: AnalyzerInput, validity: Validity) -> Changes:
    """The fingers are open; the object stays where it was, in its seat if it has been brought into one."""
    context = data.evaluation.context
    changes = gone(context.arm, context.object)
    seat = data.evaluation.step.args.get("seat")
    if isinstance(seat, str) and seat:
        changes.append(WorldChange(key=f"{context.object}.seat", value=seat, validity=validity))
    return changes


def gone(arm: str, thing: str) -> Changes:
    """The hand holds nothing any more."""
    return [
        WorldChange(key=f"{arm}.holding", value=""),
        WorldChange(key=f"{thing}.held_by", value=""),
        WorldChange(key=f"{thing}.grasp", value=None),
    ]


def still_held(belief: Belief, data: AnalyzerInput, validity: Validity) -> Changes:
    return []


def verified(belief: Belief, data: AnalyzerInput, validity: Validity) -> Changes:
    """The fingers press, and stand as wide as the thing is: it is held as it was believed to be."""
    thing, arm = data.evaluation.context.object, data.evaluation.context.arm
    grasp = belief.grasp(thing)
    if grasp is None:
        return []
    frame = geometry.compose(data.report.tcp_pose, grasp)
    return [
        WorldChange(key=f"{arm}.holding", value=thing, validity=validity),
        WorldChange(key=f"{thing}.held_by", value=arm, validity=validity),
        WorldChange(key=f"{thing}.grasp", keep_value=True, validity=validity),
        WorldChange(key=f"{thing}.frame", value=geometry.normalise(frame).tolist(), validity=validity),
    ]


EFFECTS: dict[str, Callable[[Belief, AnalyzerInput, Validity], Changes]] = {
    "taken": taken,
    "let_go": let_go,
    "still_held": still_held,
    "verified": verified,
}
