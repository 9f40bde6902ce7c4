"""What a report changes about the object in the hand: where it is, how well that is known, whether it is held. Pure."""

from __future__ import annotations

import msgspec

from rtc.programs.schema import OutcomeClass
from rtc.protocol.messages import Validity, WorldChange
from rtc.spatial import geometry
from rtc.world.facts import TRUSTED
from rtc.world.spread import even, widened
from workers.mechanisms import each
from workers.planning import pose_spread, shared_hold
from workers.tasks import flat_grip
from workers.tasks.analyze_task import AnalyzeTask, Changes

UNTURNED_RAD = 1e-6  # a smaller angle is of the arithmetic: the value stays
SPREADS, IN_PLACE = each(lambda mechanism: mechanism.spread), each(lambda mechanism: mechanism.spread_in_place)


def held_object_changes(
    task: AnalyzeTask,
    changes: Changes,
    *,
    suspect: bool,
    drops: bool = False,
) -> Changes:
    """Frame and grasp of the held object after the motion; an opened hand no longer holds it."""
    arm, thing = task.evaluation.arm, task.evaluation.held
    if not thing or task.query.grasp(thing) is None:
        return []
    let_go = any(change.key == f"{arm}.holding" and not change.keep_value for change in changes)
    if let_go or any(change.key == f"{thing}.grasp" for change in changes):
        return []
    if not task.report.tcp_pose:  # hand position unknown, so the held object's too
        doubtful = ("frame", "grasp", "held_by", "seat") if suspect else ()  # the hand may have opened, in a seat
        return [WorldChange(key=f"{thing}.{name}", keep_value=True, validity=Validity.SUSPECT) for name in doubtful]
    widened_m = _widened_m(task)
    opened = max(widened_m.values()) > task.values["opened_m"]
    tilted = max(widened_m.values()) > task.values["tilted_m"]
    fact = task.query.world.get(f"{thing}.grasp")
    trusted = fact is None or fact.validity in TRUSTED
    first = task.query.held_by(thing) in ("", arm)  # else another hand leads, and this arm was at rest
    tcp = task.report.tcp_pose if first else task.query.tcp(task.query.held_by(thing))
    held = task.query.in_hand(thing, tcp)
    assert held is not None
    frame = geometry.normalise(held)
    validity = Validity.SUSPECT if suspect or drops or tilted or not trusted else Validity.VALID
    gone = drops and not opened  # the fingers have met nothing where it should be between them
    place = Validity.INVALID if gone else validity
    moved = [WorldChange(key=f"{thing}.frame", value=frame.tolist(), validity=place)]
    if drops or opened:
        if task.query.seat(thing):
            moved.append(WorldChange(key=f"{thing}.seat", keep_value=True, validity=Validity.SUSPECT))
        return [*moved, *shared_hold.let_go(task.query, _loser(widened_m, opened), thing, Validity.SUSPECT)]
    turned = task.query.grasp_after(thing, frame, tcp)
    moved.append(WorldChange(key=f"{thing}.grasp", value=turned, keep_value=turned is None, validity=validity))
    seat = task.query.seat(thing)
    if seat and geometry.distance(frame, task.query.seated_pose(seat)) >= task.query.cell.seat(seat).depth_m:
        moved.append(WorldChange(key=f"{thing}.seat", value=""))
    return moved


def _widened_m(task: AnalyzeTask) -> dict[str, float]:
    """By how much each hand of the primitive is wider open than believed (m)."""
    arm, partner, second = task.evaluation.arm, task.context.partner, task.report.partner
    found = {arm: task.report.hand_width_m - task.query.hand_width(arm)}
    if second is not None and second.joints:
        found[partner] = second.hand_width_m - task.query.hand_width(partner)
    return found


def _loser(widened_m: dict[str, float], opened: bool) -> str:
    """The arm whose hand has lost the object: the one that is open, or else the one whose fingers have come closer."""
    return max(widened_m, key=widened_m.__getitem__) if opened else min(widened_m, key=widened_m.__getitem__)


def with_spread(task: AnalyzeTask, changes: Changes) -> Changes:
    """The changes, with the current uncertainty of an object held during the whole step."""
    thing, report = task.evaluation.held, task.report
    fact = task.query.world.get(f"{thing}.grasp") if thing else None
    if fact is None or fact.value is None:
        return changes
    spread = next((found for in_place in IN_PLACE if (found := in_place(task, changes)) is not None), None)
    if spread is None:
        moved_s = report.duration_s - report.paused_s if report.moved_s is None else report.moved_s
        spread = pose_spread.crept_spread(task.query.spread(fact.key), moved_s, task.query.cell.numbers)
        if report.tcp_pose:
            before, pull = task.query.tcp(task.evaluation.arm), task.query.cell.gravity_m_s2
            spread = pose_spread.tipped_spread(spread, before, report.tcp_pose, pull, task.values)
        if not task.query.seat(thing):  # a seat guides what is pulled out of it
            spread = pose_spread.struck_spread(spread, fact.value, report.peak_force_n, task.values)
        wider_m = max(map(abs, _widened_m(task).values()))
        if wider_m <= task.values["opened_m"]:  # else they have let go of it
            spread = pose_spread.askew_spread(spread, fact.value, wider_m, task.values["pad_m"])
            for spread_of in SPREADS:
                spread = spread_of(task, spread)
            return _between_pads(task, changes, spread)
    return _stated(changes, thing, spread)


def _between_pads(task: AnalyzeTask, changes: Changes, spread: list[float]) -> Changes:
    """The changes, with what the opening of the hand says about how the object is turned in it."""
    thing, arm, report = task.evaluation.held, task.evaluation.arm, task.report
    by_key = {change.key: change for change in changes if change.spread is None}
    held, placed = by_key.get(f"{thing}.grasp"), by_key.get(f"{thing}.frame")
    grasp = held.value if held is not None and not held.keep_value else task.query.grasp(thing)
    alone = task.query.held_by(thing) == arm and not task.query.sharers(arm)
    if held is None or placed is None or grasp is None or not alone or not report.tcp_pose:
        return _stated(changes, thing, spread)
    lies, spread = flat_grip.between_pads(task.query, thing, grasp, spread, report.hand_width_m, task.values["pad_m"])
    if geometry.angle(lies, grasp) < UNTURNED_RAD:
        return _stated(changes, thing, spread)
    turned = geometry.normalise(geometry.compose(report.tcp_pose, lies)).tolist()
    values = {held.key: lies.tolist(), placed.key: turned}
    moved = [
        msgspec.structs.replace(change, value=values[change.key], keep_value=False) if change.key in values else change
        for change in changes
    ]
    return _stated(moved, thing, spread)


def _stated(changes: Changes, thing: str, spread: list[float]) -> Changes:
    """The changes, with this spread where they state the pose of the object without one."""
    keys = {f"{thing}.frame", f"{thing}.grasp"}
    return [
        msgspec.structs.replace(change, spread=spread)
        if change.key in keys and change.spread is None and (change.keep_value or change.value is not None)
        else change
        for change in changes
    ]


def moved_in_hand(
    task: AnalyzeTask,
    changes: Changes,
    failure: OutcomeClass,
    *,
    pressed: bool,
) -> Changes:
    """The changes, with increased uncertainty of a held object that the failure may have moved in the hand.

    `pressed`: the hand or the object pressed on something. A hinge keeps its object in place.
    """
    values, held = task.values, task.evaluation.held
    if task.query.hinge(held) is not None:
        return changes
    if failure.misplaced:
        more = even(values["misplaced_m"], values["misplaced_rad"])
    elif pressed:
        more = even(values["pressed_m"], values["pressed_rad"])
    else:
        return changes
    keys = {f"{held}.{attribute}" for attribute in ("frame", "grasp")}
    return [
        msgspec.structs.replace(change, spread=widened(change.spread or task.query.spread(change.key), more))
        if change.key in keys and change.validity is Validity.SUSPECT
        else change
        for change in changes
    ]
