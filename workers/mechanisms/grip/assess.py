"""What a report says about the object that a hand takes, holds or lets go of. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rtc.protocol.causes import NeedUnmet
from rtc.protocol.messages import HandStep, Validity, WorldChange
from rtc.protocol.outcomes import RefusalReason, Refused, StopReason
from rtc.spatial import geometry
from rtc.world.spread import EXACT, Spread, even, widened
from workers.planning import shared_hold, trust
from workers.planning.world_query import WorldQuery
from workers.tasks import flat_grip, seated
from workers.tasks.analyze_task import AnalyzeTask, Changes
from workers.tasks.seated import IN_SEAT_M

CATCHES_M = 0.005  # maximum distance from the seated pose at which a catch holds a released object
FREE_M, FREE_RAD = 0.04, 0.25  # how far a closing hand moves and turns a free module: up to 34 mm and 12 deg in physics


def taken(task: AnalyzeTask, validity: Validity) -> Changes:
    """The hand holds the object; the finger measurement corrects its frame, and that of its seat.

    Along the closing axis the grasp point is centred between the fingers (R149). The other axes keep their uncertainty;
    those of a free object become more uncertain.
    """
    thing, arm, query = task.context.object, task.arm, task.query
    if query.held_by(thing) not in ("", arm):  # the second hand: the facts of the object refer to the first one
        return [WorldChange(key=f"{arm}.holding", value=thing, validity=validity)]
    frame, spread = flat_grip.between_fingers(task, _moved_by_closing(query, thing))
    if query.hinge(thing) is not None:
        point = task.point.frame.pose[:3]
        frame = query.hung(thing, point, geometry.transform_point(frame, point))
    grasp = geometry.normalise(geometry.relative(task.report.tcp_pose, frame))
    return [
        *shared_hold.held(arm, thing, grasp.tolist(), validity, spread),
        WorldChange(key=f"{thing}.frame", value=frame.tolist(), validity=validity, spread=spread),
        *seated.its_frame(query, thing, frame, spread, task.step.of_kind(HandStep).play_m, validity),
    ]


def interrupted(task: AnalyzeTask) -> Changes:
    """Fingers that were stopped while they closed, and press at the expected width, hold the object (suspect).

    Without a report of the hand the fingers may press too.
    """
    evaluation, report = task.evaluation, task.report
    if evaluation.width_m is None:
        return []
    if not report.tcp_pose:
        return _perhaps_taken(task) if report.reason not in (StopReason.REFUSED, StopReason.BLOCKED) else []
    least, most = evaluation.width_m
    pressing = report.hand_force_n >= task.values["pressing_n"]
    return taken(task, Validity.SUSPECT) if pressing and least <= report.hand_width_m <= most else []


def _perhaps_taken(task: AnalyzeTask) -> Changes:
    """The hand was closing when its report was lost: the object may be in it, where it was believed to be."""
    thing, arm, query, doubt = task.context.object, task.arm, task.query, Validity.SUSPECT
    if query.held_by(thing) not in ("", arm):
        return [WorldChange(key=f"{arm}.holding", value=thing, validity=doubt)]
    frame, spread = task.object_frame
    grasp = geometry.normalise(geometry.relative(query.tcp(arm), frame))
    return [
        *shared_hold.held(arm, thing, grasp.tolist(), doubt, widened(spread, _moved_by_closing(query, thing))),
        WorldChange(key=f"{thing}.frame", keep_value=True, validity=doubt),
    ]


def _moved_by_closing(query: WorldQuery, thing: str) -> Spread:
    """How far a closing hand may move the object along and about each axis: an object in a seat hardly moves."""
    seated = bool(query.seat(thing)) and query.trusts(f"{thing}.seat")
    rests = seated or query.held_by(thing) or query.hinge(thing) or query.cell.object(thing).fixed
    return EXACT if rests else even(FREE_M, FREE_RAD)


def let_go(task: AnalyzeTask, validity: Validity) -> Changes:
    """The fingers are open; the object stays in place, in its seat if the step placed it there."""
    thing, query, seat = task.context.object, task.query, task.step.of_kind(HandStep).seat
    changes = shared_hold.let_go(query, task.arm, thing)
    if query.sharers(task.arm):  # another hand holds it where it is
        return changes
    if seat:
        changes.append(WorldChange(key=f"{thing}.seat", value=seat, validity=validity))
        frame, spread = seated.set_down(query, thing, seat)
        return [*changes, WorldChange(key=f"{thing}.frame", value=frame.tolist(), validity=validity, spread=spread)]
    if query.hinge(thing) is not None:  # its hinge holds it
        return changes
    if not seated.seat_at(query.frame(thing), query, CATCHES_M):
        changes.append(WorldChange(key=f"{thing}.frame", keep_value=True, validity=Validity.SUSPECT))
    near = seated.seat_at(query.frame(thing), query, IN_SEAT_M)
    if near and query.seat(thing) != near:  # probably seated; a tug has not tested it
        changes.append(WorldChange(key=f"{thing}.seat", value=near, validity=Validity.SUSPECT))
    return changes


def let_drift(task: AnalyzeTask, validity: Validity) -> Changes:
    """The fingers are open and nothing holds the object: its frame is suspect."""
    thing = task.context.object
    changes = shared_hold.let_go(task.query, task.arm, thing)
    if task.query.sharers(task.arm):
        return changes
    return [
        *changes,
        WorldChange(key=f"{thing}.seat", value=""),
        WorldChange(key=f"{thing}.frame", keep_value=True, validity=Validity.SUSPECT),
    ]


def still_held(task: AnalyzeTask, validity: Validity) -> Changes:
    """Nothing: the hand has closed on what it holds, with another force."""
    return []


def verified(task: AnalyzeTask, validity: Validity) -> Changes:
    """The fingers press at the object's width: the hand still holds the object.

    Its pose in the hand is not measured: it keeps its uncertainty, which a failure by contact has increased.
    """
    thing, arm, query = task.context.object, task.arm, task.query
    if query.held_by(thing) not in ("", arm):  # the second of two hands
        return [WorldChange(key=f"{arm}.holding", value=thing, validity=validity)]
    frame = query.in_hand(thing, task.report.tcp_pose)
    if frame is None:
        return []
    turned = query.grasp_after(thing, frame, task.report.tcp_pose)
    return [
        *shared_hold.held(arm, thing, turned, validity),
        WorldChange(key=f"{thing}.frame", value=geometry.normalise(frame).tolist(), validity=validity),
    ]


def stated_in_hand(thing: str, frame: Any, query: WorldQuery, values: Mapping[str, float]) -> Changes:
    """Grasp of a held object that is stated to be at this frame; raises Refused if all its grasp points are too far
    from the tcp."""
    arm = query.held_by(thing)
    if not arm:
        return []
    tcp, most_mm = query.tcp(arm), values["in_hand_m"] * 1000
    away_m = query.off_hand_m(thing, frame, tcp)
    if away_m > values["in_hand_m"]:
        raise Refused.because(
            RefusalReason.INFEASIBLE,
            f"{thing} is held by {arm}, and would be {away_m * 1000:.0f} mm from its fingers; "
            f"{most_mm:.0f} mm is the most",
            where=f"{thing}.frame",
            clears=f"give its present world pose, within {most_mm:.0f} mm of the fingers; "
            "open the hand first if it is not in it",
            cause=NeedUnmet(need="object_free", by=arm),
        )
    grasp = geometry.normalise(geometry.relative(tcp, frame)).tolist()
    return shared_hold.held(arm, thing, grasp, spread=trust.stated_spread(query.cell.numbers))
