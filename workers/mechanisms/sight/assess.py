"""World changes of what a camera has seen: the pose of a body with its uncertainty, and what follows from it. Pure.

Figures are args of the step: `seen_m` and `seen_rad` are the accuracy of cameras and of their places in the cell file;
`play_m` is the play of an object in its seat. `seated_m` is the distance from a seat at which an object is still in it.
A step with `play_m` also states where the seat of the object is, and what is mounted on the body. A TRACK without it
reserves none of them, so a body that carries them stays where it is believed to be, and is in doubt if it is elsewhere.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rtc.model.cells import parts
from rtc.protocol.messages import Fact, LookStep, Validity, WorldChange
from rtc.protocol.outcomes import Sighting, StopReason
from rtc.sensing import rest
from rtc.spatial import geometry, hinges
from rtc.spatial.geometry import Array
from rtc.world.spread import EXACT, Spread, even, widened
from workers.planning import pose_spread, shared_hold, trust
from workers.planning.world_query import WorldQuery
from workers.tasks import flat_grip, seated
from workers.tasks.analyze_task import AnalyzeTask, Changes
from workers.tasks.flat_grip import Found

IN_HAND_M = 0.06  # maximum distance of a held object's grasp point from the middle between the fingers
#: findings of a look: the body moves, it is known better, it is not between the fingers of the hand that holds it
MOVES, VAGUE, DROPPED = "moves", "vague", "dropped"
OLD_S = 2.0  # an older sighting is not trusted, unless a hand has held the body since
WIDEST_RAD = math.pi


def sighted(task: AnalyzeTask, validity: Validity) -> Changes:
    """The body is where the camera has seen it; nothing changes if it has not, or if it is known better."""
    sighting, body = task.report.sighting, task.evaluation.body
    if sighting is None or is_vague(task):
        return []
    if _doubt(task, sighting):
        validity = Validity.SUSPECT
    frame, spread = geometry.normalise(sighting.pose), spread_of(sighting, task)
    holder = task.query.held_by(body)
    if holder and task.query.hinge(body) is None:
        frame, spread = _between_pads(task, holder, frame, spread)
    change = WorldChange(key=f"{body}.frame", value=frame.tolist(), validity=validity, spread=spread)
    evidence = WorldChange(key=f"{body}.sighting", value=_evidence(sighting, task.report.performer, frame, spread))
    if _only_watched(task):
        return [WorldChange(key=change.key, keep_value=True, validity=validity), evidence]
    changes = [change, evidence]
    if task.query.cell.mounted(body):
        return [*changes, *_mounted(task.query, change)]
    if task.query.is_seat(body):
        return [*changes, *seated.content(task.query, body, frame, spread, validity)]
    if holder:
        return [*changes, *_in_hand(task.query, body, frame, spread, validity)]
    return [*changes, *_seated(task, frame, spread, validity)]


def is_vague(task: AnalyzeTask) -> bool:
    """Whether two attitudes explain the pictures, and the trusted pose is one that they allow and is known better."""
    sighting, body = task.report.sighting, task.evaluation.body
    if sighting is None or not sighting.ambiguous or not task.query.trusts(f"{body}.frame"):
        return False
    frame, believed = geometry.normalise(sighting.pose), task.query.pose(body)
    turned = geometry.rotate(geometry.inverse(frame), geometry.rotation_vector(frame, believed))
    off = [*geometry.relative(frame, believed)[:3], *turned]
    seen, known = spread_of(sighting, task), task.query.spread(f"{body}.frame")
    better = math.hypot(*known[:3]) <= math.hypot(*seen[:3]) and math.hypot(*known[3:]) <= math.hypot(*seen[3:])
    return better and all(abs(d) <= a + b for d, a, b in zip(off, seen, known, strict=True))


def wrong_sighting(task: AnalyzeTask) -> str:
    """A body was seen beside its seat (`displaced`), on the move (`moves`), in two attitudes (`vague`), outside the
    hand that should hold it (`dropped`), or not at all (`unseen`). Empty: nothing is wrong."""
    report, step, holder = task.report, task.step.of_kind(LookStep), task.context.arm
    vague = is_vague(task)
    if task.evaluation.body_pose is not None:
        if _is_displaced(task, task.evaluation.body_pose):
            return VAGUE if vague else "displaced"
    elif report.reason is StopReason.GOAL and report.sighting is None:
        return "unseen"
    elif step.at_rest and report.sighting is not None and rest.moves(report.sighting.velocity):
        return MOVES
    elif vague and report.reason is StopReason.FOUND:
        return VAGUE
    if report.sighting is None or not holder or task.query.held_by(task.evaluation.body) != holder:
        return ""
    return "" if _is_in_hand(task, holder) else DROPPED


def _is_displaced(task: AnalyzeTask, place: list[float]) -> bool:
    """Whether the body was seen farther from its place in the seat than that place is unsure, and `within` more."""
    sighting, step = task.report.sighting, task.step.of_kind(LookStep)
    if sighting is None:
        return False
    inside = task.query.cell.seat(step.seat).module_frame.pose
    unsure = pose_spread.spread_at(task.query.spread(f"{step.seat}.frame"), inside)
    off = [max(0.0, abs(n) - m) for n, m in zip(pose_spread.error_of(place, sighting.pose), unsure, strict=True)]
    return math.hypot(*off[:3]) > step.within_m or math.hypot(*off[3:]) > step.within_rad


def after_failure(task: AnalyzeTask, _: bool) -> Changes:
    """The body was seen, but the look was stopped, or the body moves or is not in the hand."""
    wrong = wrong_sighting(task) if task.report.reason in task.step.expect else ""
    return sighted(task, Validity.VALID) if wrong in ("", MOVES, DROPPED) else []


def unseen(task: AnalyzeTask, _: Validity) -> Changes:
    """The cameras have not found the body: another way to locate it is chosen until one of them does."""
    return [WorldChange(key=f"{task.evaluation.body}.sighting", value=None)]


def in_words(task: AnalyzeTask) -> str:
    """The message of a look that has measured the body worse than it is known; empty: the message of the report."""
    sighting = task.report.sighting
    vague = sighting is not None and task.report.reason in task.step.expect and wrong_sighting(task) == VAGUE
    return _vagueness(sighting) if sighting is not None and vague else ""


def _vagueness(sighting: Sighting) -> str:
    degrees, tags = math.degrees(trust.deviations(sighting)[1]), ", ".join(map(str, sighting.tags))
    return f"not well enough: two attitudes, some {degrees:.0f} deg apart, fit tags {tags}; its pose is known better"


def _evidence(sighting: Sighting, camera: str, frame: Array, spread: list[float]) -> dict[str, Any]:
    """What the pose of a body is based on, for people; and how well a look from there knows it (`trust.last_look`)."""
    metres, radians = trust.deviations(sighting)
    return {
        "cameras": sighting.cameras or [camera],
        "tags": sighting.tags,
        "pictures": sighting.pictures,
        "error_px": sighting.error_px,
        "deviation_m": metres,
        "deviation_rad": radians,
        "age_s": sighting.age_s,  # at the report
        "ambiguous": sighting.ambiguous,
        "pose": frame.tolist(),
        "spread": [*spread],
    }


def spread_of(sighting: Sighting, task: AnalyzeTask) -> list[float]:
    """Half-widths along and about the axes of the body."""
    turn = geometry.to_matrix(sighting.pose)[:3, :3]
    covariance = np.asarray(sighting.covariance).reshape(6, 6)
    own = [turn.T @ block @ turn for block in (covariance[:3, :3], covariance[3:, 3:])]
    bounds = [trust.SIGMAS * math.sqrt(max(0.0, float(n))) for block in own for n in np.diag(block)]
    floor = even(task.step.of_kind(LookStep).seen_m, task.step.of_kind(LookStep).seen_rad)
    return [*widened(bounds, floor)[:3], *(min(WIDEST_RAD, n) for n in widened(bounds, floor)[3:])]


def _doubt(task: AnalyzeTask, sighting: Sighting) -> str:
    """Why the body may not be where it was seen; empty if it is there.

    A busy machine needs seconds to find the tags in a picture. A look reserves the hand that holds its body, so a held
    body has not moved since. The hand is free to move after a TRACK has lost its body.
    """
    if rest.moves(sighting.velocity):
        return "it moves"
    if _only_watched(task) and _is_elsewhere(task, sighting):
        return f"LOCATE {task.evaluation.body} states where it is, and what is mounted on it"
    rests = task.report.reason is StopReason.FOUND and task.query.held_by(task.evaluation.body)
    return "" if rests or sighting.age_s <= OLD_S else f"it was seen {sighting.age_s:.1f} s ago"


def _only_watched(task: AnalyzeTask) -> bool:
    """Whether the body carries others, which the step does not place with it."""
    return task.step.of_kind(LookStep).play_m is None and bool(task.query.cell.mounted(task.evaluation.body))


def _is_elsewhere(task: AnalyzeTask, sighting: Sighting) -> bool:
    """Whether the body is farther from where it is believed to be than both poses may be wrong."""
    believed = task.query.frame(task.evaluation.body)
    off = pose_spread.error_of(believed, geometry.normalise(sighting.pose))
    bounds = widened(spread_of(sighting, task), task.query.spread(f"{task.evaluation.body}.frame"))
    return any(abs(error) > bound for error, bound in zip(off, bounds, strict=True))


def speed_in_words(task: AnalyzeTask) -> str:
    """The speed at which the camera has seen the body move."""
    sighting = task.report.sighting
    metres, radians = rest.speeds(sighting.velocity if sighting is not None else None)
    return f"{1e3 * metres:.1f} mm/s, {math.degrees(radians):.1f} deg/s"


def _is_in_hand(task: AnalyzeTask, arm: str) -> bool:
    """Whether the body is between the fingers of the arm, as the camera has seen it."""
    assert task.report.sighting is not None
    return _is_at(task.query, task.query.tcp(arm), task.evaluation.body, geometry.normalise(task.report.sighting.pose))


def _is_at(query: WorldQuery, tcp: Array, thing: str, frame: Array) -> bool:
    return query.off_hand_m(thing, frame, tcp) <= IN_HAND_M


def _between_pads(task: AnalyzeTask, arm: str, frame: Array, spread: list[float]) -> Found:
    """Where a body is that a hand has been seen to hold: it may have turned flat between the pads since."""
    query, body, tcp = task.query, task.evaluation.body, task.query.tcp(arm)
    if query.sharers(arm) or not _is_at(query, tcp, body, frame):
        return frame, spread
    opening_m, pad_m = query.hand_width(arm), task.values["pad_m"]
    grasp, spread = flat_grip.between_pads(query, body, geometry.relative(tcp, frame), spread, opening_m, pad_m)
    return geometry.normalise(geometry.compose(tcp, grasp)), spread


def _in_hand(query: WorldQuery, thing: str, frame: Array, spread: list[float], validity: Validity) -> Changes:
    """A held object: its pose in the hand. One that is far from the fingers is not held any more."""
    arm = query.held_by(thing)
    tcp = query.tcp(arm)
    if not _is_at(query, tcp, thing, frame):
        return [
            WorldChange(key=f"{arm}.holding", value=""),
            WorldChange(key=f"{thing}.held_by", value=""),
            WorldChange(key=f"{thing}.grasp", value=None),
        ]
    grasp = geometry.normalise(geometry.relative(tcp, frame)).tolist()
    return shared_hold.held(arm, thing, grasp, validity, spread)


def _seated(task: AnalyzeTask, frame: Array, spread: list[float], validity: Validity) -> Changes:
    """The seat that the object is in. A step with `play_m` also locates it: it holds the object up to this play."""
    thing, step = task.evaluation.body, task.step.of_kind(LookStep)
    if task.query.cell.object(thing).fixed or task.query.hinge(thing) is not None:
        return []
    seat = seated.seat_at(frame, task.query, step.seated_m)
    if any(other != thing for other in task.query.inside(seat)):
        seat = ""
    changes = [WorldChange(key=f"{thing}.seat", value=seat, validity=validity)]
    if seat != task.query.seat(thing):
        return changes
    return [*changes, *seated.its_frame(task.query, thing, frame, spread, step.play_m or 0.0, validity)]


def _mounted(query: WorldQuery, body: WorldChange) -> Changes:
    """What is mounted on a body is where the body has it, after this change of the body's frame.

    What was measured by itself, as well as the body or better, stays where it is, if the body has it there as far as
    both are known. Of an object with a hinge the angle counts from the hinge on the body in either case. One in a hand
    turns about that hinge to where the hand has it.
    """
    changes: Changes = []
    after, name = query.after([body]), body.key.rpartition(".")[0]
    for part in query.cell.mounted(name):
        key = f"{part.name}.frame"
        fact, place = query.world.get(key), _in_place(after, part, query.angle(part.name))
        surveyed = (isinstance(part, parts.Object) and part.surveyed_spread) or EXACT
        on_body = pose_spread.spread_at(body.spread or EXACT, geometry.relative(after.frame(name), place))
        spread = widened(on_body, surveyed)
        validity = fact.validity if fact is not None and body.validity is Validity.VALID else body.validity
        if isinstance(part, parts.Object) and query.held_by(part.name):
            changes += _hinge_in_hand(after, part, spread)
            continue
        if fact is not None and _is_known_there(after, part, fact, spread, surveyed):
            changes.append(WorldChange(key=key, value=fact.value, validity=fact.validity, spread=fact.spread))
            continue
        place = geometry.normalise(place)
        changes.append(WorldChange(key=key, value=place.tolist(), validity=validity, spread=spread))
        if isinstance(part, parts.Seat):
            changes += seated.content(query, part.name, place, spread, validity)
    return changes


def _hinge_in_hand(query: WorldQuery, part: parts.Object, spread: list[float]) -> Changes:
    """A held object with a hinge: its hand has the bar, and the body has the hinge. It is unsure by as much as they
    disagree."""
    grasp = query.grasp(part.name)
    if part.hinge is None or grasp is None:
        return []
    bar = hinges.bar((point.frame.xyz for point in part.grasp_points), grasp)
    where = geometry.transform_point(query.frame(part.name), bar)
    place = hinges.at_hand(query.mount(part), part.hinge.axis, part.hinge.range_rad, bar, where)
    inside = geometry.relative(query.tcp(query.held_by(part.name)), place)
    off_m = float(np.linalg.norm(geometry.transform_point(place, bar) - where))
    lever_m = float(np.linalg.norm(np.cross(part.hinge.axis, bar)))
    spread = widened(spread, even(off_m, off_m / lever_m))
    values = {"frame": place, "grasp": inside}
    return [
        WorldChange(
            key=f"{part.name}.{name}",
            value=geometry.normalise(pose).tolist(),
            validity=query.world.facts[f"{part.name}.{name}"].validity,
            spread=spread,
        )
        for name, pose in values.items()
    ]


def _in_place(query: WorldQuery, part: parts.Seat | parts.Object, angle: float) -> Array:
    """The frame of a part on its body; of one with a hinge at this angle (rad), of a bolt as far out as it is."""
    home = query.mount(part)
    if isinstance(part, parts.Object) and part.hinge is not None:
        return hinges.turned(home, part.hinge.axis, angle)
    if isinstance(part, parts.Object) and part.thread is not None:
        out_m = part.thread.pitch_m * query.turns(part.name)
        return geometry.compose(home, (0.0, 0.0, out_m, 0.0, 0.0, 0.0, 1.0))
    return home


def _is_known_there(
    query: WorldQuery, part: parts.Seat | parts.Object, fact: Fact, spread: Spread, surveyed: Spread
) -> bool:
    """Whether a part was measured by itself where its body has it, and at least as well."""
    own = fact.spread
    if own is None or list(own) == list(surveyed) or max(own[:3]) > max(spread[:3]):
        return False
    hinge = part.hinge if isinstance(part, parts.Object) else None
    angle = hinges.angle_of(query.mount(part), hinge.axis, fact.value) if hinge is not None else 0.0
    place = _in_place(query, part, angle)
    off = pose_spread.error_of(place, fact.value)
    return all(abs(error) <= bound for error, bound in zip(off, widened(spread, own), strict=True))


def found(task: AnalyzeTask) -> tuple[str, str]:
    """(what the camera has seen, against what was believed; that the pose is suspect although it was seen)."""
    sighting, body = task.report.sighting, task.evaluation.body
    if sighting is None:
        return "", ""
    seats = {seat.name for seat in task.query.cell.seats}
    before = task.query.seat_frame(body) if body in seats else task.query.frame(body)
    off_mm, turned_deg = (
        1e3 * geometry.distance(sighting.pose, before),
        math.degrees(geometry.angle(sighting.pose, before)),
    )
    metres, radians = trust.deviations(sighting)
    cameras = f" of {' and '.join(sighting.cameras)}" if sighting.cameras else ""
    words = f"{off_mm:.1f} mm and {turned_deg:.1f} deg from where it was believed to be; "
    words += f"+- {1e3 * metres:.1f} mm, {math.degrees(radians):.2f} deg by tags "
    words += f"{', '.join(map(str, sighting.tags))}{cameras}, {sighting.error_px:.2f} px off, "
    words += f"{1e3 * sighting.age_s:.0f} ms old" + ", ambiguous attitude" * sighting.ambiguous
    if not (doubt := _doubt(task, sighting)):
        return words, ""
    return f"{words}; its pose is suspect: {doubt}", f"the pose of {body} is suspect: {doubt}"
