"""What to do after a failure: the rows of the program that apply, in their order. Pure."""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from rtc.programs.schema import OutcomeClass
from rtc.protocol.advice import NOTHING, Advice, Alternative, by_person, fill_in, in_order, sentences_of
from rtc.protocol.messages import Validity
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats
from workers.analyzer import failure_words, what_is_left
from workers.analyzer.post_conditions import is_held_askew, pressing_n
from workers.mechanisms import joined
from workers.mechanisms.collision_advice import about
from workers.planning import trust
from workers.tasks.analyze_task import AnalyzeTask, Changes

#: placeholder of advice -> what stands for it; stop reason -> what clears it, where its class of failures does not help
ADVICE = joined(lambda mechanism: mechanism.advice)
CURES = joined(lambda mechanism: mechanism.cures)
SHORT_M = 0.003  # the direction of a shorter way means nothing
AWAY_CM = 5.0  # by how much an arm is to move away from what it has pressed on
BACK, SLOT, LET_GO, LINE = "leave_back", "leave_slot", "leave_held", "leave_line"  # rows of `clears`
BY_JOINTS = "move_joint"  # space of a step
DOUBTFUL = (Validity.SUSPECT, Validity.INVALID)
IN_SLOT_M = 0.010  # a shorter way in a slot frees nothing, and one that ends nearer to the bottom may press on it
BACKWARDS = 0.7  # cosine of the angle between the way of a hand and its tool axis from which on it went back


def what_clears(
    task: AnalyzeTask, reason: StopReason, failure: OutcomeClass, changes: Changes, *, asked: bool, pressed: bool
) -> Advice:
    """What to do now: first about what the hand holds and presses on, then about facts in doubt, then try again.

    `asked`: a reflex of the command has ended the step. `pressed`: the hand presses on something."""
    target, askew = task.context.target, is_held_askew(task)
    # A seat needs a better known pose in the hand than VERIFY leaves after that, and a free motion more room.
    misplaced = failure.misplaced or askew or (pressed and bool(target))
    cures = _ways_to_clear(task, changes, moved=pressed or misplaced, misplaced=misplaced)
    row, clears = (task.program.clears.get("asked", []), []) if asked else (failure.pressing, failure.clears)
    by_way = any("{leave}" in one.sentences for one in (*row, *clears))
    way, back = _way_to_leave(task) if (row or by_way) and pressing_n(task) else ("", "")
    pressing = _leaving(task, row, way, back) if way else []
    clears = _leaving(task, clears, way or BACK, back)
    # RETRACT works despite doubts about what is in the hand, and a hand may let go of it; other ways do not.
    doubtful = bool(way) and not (by_way and way in (BACK, LET_GO))
    of_held = [key for key in cures if key.rpartition(".")[0] == task.evaluation.held]
    held = [cures[key] for key in of_held if doubtful]
    own = [*held, pressing]
    again: Advice = []
    rest = [Alternative(sentences=[left], instead=True)] if (left := what_is_left.sentence(task)) else []
    if not asked:
        own += [
            (CURES[reason](task, about) if reason in CURES else []) or clears,
            by_person(*_higher_limit(task)),
        ]
        again = [] if askew else failure.again  # the fingers close no further
        again = [_the_rest(one, rest) if rest and one.again else one for one in again]
    if asked or reason is StopReason.HALT:
        again = again or ([] if pressing else rest)
    if by_way and way == SLOT and float(back) > 0.0:  # what was pressed down is not pressed down again
        again = []
    if by_way and way == LET_GO:  # the hand is empty then
        again = []
        cures |= dict.fromkeys(of_held, _seen(task, str(task.evaluation.held)))
    if any("{target_cure}" in one.sentences for one in again):
        again = fill_in(again, {"target_cure": cures.pop(f"{target}.frame", [NOTHING])})
    todo = in_order(*own, *cures.values(), again)
    return fill_in(todo, {**failure_words.texts(task, reason), **{name: of(task) for name, of in ADVICE.items()}})


def _seen(task: AnalyzeTask, body: str) -> Advice:
    """The look at a body that no hand holds any more; empty if no camera would see it."""
    return fill_in(task.program.clears.get("seen", []), {"location": body}) if task.query.cameras(body) else []


def _the_rest(one: Alternative, rest: Advice) -> Alternative:
    """The rest of a relative sentence in the place of that sentence."""
    return replace(one, sentences=[*one.sentences, *rest[0].sentences], again=False, instead=True)


def _higher_limit(task: AnalyzeTask) -> list[str]:
    """The advice if the force or the time that ended the step is the limit of the sentence."""
    limits, report = task.context.limits, task.report
    if limits.time_s is not None and report.reason is StopReason.TIMEOUT:
        return [f"a TIME-LIMIT above {limits.time_s:g} S, if it needs more time"]
    if limits.torque_nm is not None and report.turned_rad is not None and report.reason is StopReason.TORQUE_LIMIT:
        return [f"a TORQUE-LIMIT above {limits.torque_nm:g} NM, if it may be turned with more"]
    limit_n = limits.force_n
    if limit_n is None or report.limit is None or report.reason is not StopReason.FORCE_LIMIT:
        return []
    own = math.isclose(report.limit, limit_n)
    return [f"a FORCE-LIMIT above {limit_n:g} N, if nothing is in the way"] if own else []


def _ways_to_clear(task: AnalyzeTask, changes: Changes, *, moved: bool, misplaced: bool) -> dict[str, Advice]:
    """The advice that clears the facts made suspect or invalid by these changes, by the first fact that it clears.

    `moved`: what is held may have moved in the hand. `misplaced`: its fingers do not help."""
    after = task.query.after(changes)
    suspect = [change.key for change in changes if change.validity in DOUBTFUL]
    if any(key.endswith(".holding") for key in suspect):  # what it may hold is neither looked for nor taken before that
        suspect = [key for key in suspect if not key.endswith(".frame") or after.held_by(key.rpartition(".")[0])]
    clears = task.program.clears
    if moved:
        held = next((change.key for change in changes if change.key.endswith(".grasp")), "").rpartition(".")[0]
        seen = "seen" in clears and held and after.cameras(held)
        row = "seen" if seen else "misplaced" if misplaced else "grasp"
        clears = {**clears, "grasp": clears[row]}
    first: dict[str, Advice] = {}
    for key in suspect:
        if key.rpartition(".")[2] in clears and (cure := trust.remedy(after, key, clears)) not in first.values():
            first[key] = cure
    return first


def _leaving(task: AnalyzeTask, row: Advice, way: str, back: str) -> Advice:
    """The advice for an arm that pressed on something. `way`, `back`: of `_way_to_leave`."""
    advice = fill_in(row, {"leave": task.program.clears.get(way, [])})
    away = _away(task) if any("{away}" in sentence for sentence in sentences_of(advice)) else ""
    return fill_in(advice, {"back": back, "away": away})


def _way_to_leave(task: AnalyzeTask) -> tuple[str, str]:
    """How an arm leaves what it presses on where it may touch something: the row of `clears`, and the way (cm).

    Back along its tool. Where it came to a stop on that way: along the slot that an object was leaving, or along
    another line. Near the bottom of the slot the hand lets go. Out of a motion of the joints, which turns the hand on
    its way, it goes back the way that it came there: along its tool what it met may lie behind its fingers."""
    evaluation, report = task.evaluation, task.report
    if evaluation.start_joints is None:
        return BACK, ""
    tool = geometry.rotate(report.tcp_pose, [0.0, 0.0, 1.0])
    if (turned := _back_by_joints(task)) is not None:
        return (BACK if float(turned @ tool) < -BACKWARDS else LINE), ""
    came = task.query.model.arms[evaluation.arm].fk(evaluation.start_joints)[:3] - np.asarray(report.tcp_pose[:3])
    came_m, held = float(np.linalg.norm(came)), evaluation.held
    frame = task.query.in_hand(held, report.tcp_pose) if held and evaluation.step.leaves_seat else None
    if frame is not None and (seat := task.query.slot_at(frame)) and came_m >= IN_SLOT_M:
        back_m = _along_slot_m(task, seat, frame, came)
        return (SLOT, f"{100.0 * back_m:.2g}") if abs(back_m) >= IN_SLOT_M else (LET_GO, "")
    backwards = float(came @ tool) > BACKWARDS * came_m
    return LINE if came_m > SHORT_M and backwards else BACK, ""


def _back_by_joints(task: AnalyzeTask) -> Array | None:
    """The direction in which the hand would begin to go back by a motion of its joints, as it came; None: it came along
    a line, or from here."""
    evaluation, joints = task.evaluation, task.report.joints
    if evaluation.step.space != BY_JOINTS or evaluation.start_joints is None:
        return None
    arm = task.query.model.arms[evaluation.arm]
    if float(np.linalg.norm(arm.fk(evaluation.start_joints)[:3] - arm.fk(joints)[:3])) <= SHORT_M:
        return None
    back: Array = arm.jacobian(joints)[:3] @ (np.asarray(evaluation.start_joints) - np.asarray(joints))
    length = float(np.linalg.norm(back))
    return back / length if length > 0.0 else None


def _along_slot_m(task: AnalyzeTask, seat: str, frame: Floats, came: Floats) -> float:
    """The way back along a slot (m), out of it or, less than 0, into it. Downwards it ends before the bottom, which
    carries the object: its place in the hand is in doubt. `came`: from here to where the hand began."""
    along_m, above_m = float(np.asarray(came) @ task.query.out_of(seat)), task.query.out_m(seat, frame)
    if along_m > 0.0:
        return min(AWAY_CM / 100.0, along_m)
    return -min(AWAY_CM / 100.0, -along_m, max(0.0, above_m - IN_SLOT_M))


def _away(task: AnalyzeTask) -> str:
    """The line along an axis of the world that leads away from what the arm presses on, in words.

    It goes back the way that the hand came, and not beyond its start, rather than with the force: an object that turns
    in the hand may press aside."""
    evaluation, report = task.evaluation, task.report
    assert report.trip_wrench is not None
    pose = report.trip_pose or report.tcp_pose
    force = geometry.rotate(pose, report.trip_wrench[:3])
    away, most_m = force / np.linalg.norm(force), np.full(3, math.inf)
    if (turned := _back_by_joints(task)) is not None:
        away = turned  # a force from aside would lead into what the hand has come past
    elif evaluation.start_joints is not None:
        came = task.query.model.arms[evaluation.arm].fk(evaluation.start_joints)[:3] - np.asarray(pose[:3])
        if (came_m := float(np.linalg.norm(came))) > SHORT_M:
            away = away + 2.0 * came / came_m
            most_m = np.where(came * away > SHORT_M * np.abs(away), np.abs(came), math.inf)
    axis = int(np.abs(away).argmax())
    way_cm = min(AWAY_CM, 100.0 * float(most_m[axis]))
    return f"{math.copysign(way_cm, away[axis]):.2g} CM ALONG {'XYZ'[axis]}"
