"""What a report changes about arms, and about what they have touched. Pure."""

from __future__ import annotations

import msgspec

from rtc.programs.schema import OutcomeClass
from rtc.protocol.messages import EndReport, Validity, WorldChange
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry
from workers.planning import segments
from workers.tasks.analyze_task import AnalyzeTask, Changes

THIN_M = 0.002  # fingers closer together than this hold nothing


def arm_changes(task: AnalyzeTask) -> Changes:
    """The facts of the arm of the step."""
    commanded = bool(task.step.op) or task.step.do == "proc" or bool(task.step.words.operator_has)
    return _reported(task, task.report, task.evaluation.arm, hand_commanded=commanded)


def _reported(task: AnalyzeTask, report: EndReport, arm: str, *, hand_commanded: bool) -> Changes:
    """Joints and hand width as reported; suspect and unchanged, like what it holds, if the report has no joints.

    The width of a hand that has opened or closed without a command is suspect: the fingers may still move. A hand that
    was commanded also has the force with which it grips.
    """
    if not arm:
        return []  # a stated or observed fact moves no arm
    if len(report.joints) != len(task.query.cell.arm(arm).joints):
        return [
            WorldChange(key=f"{arm}.{attribute}", keep_value=True, validity=Validity.SUSPECT)
            for attribute in ("joints", "hand_width", "holding")
        ]
    width_m = max(0.0, report.hand_width_m)
    moves = not hand_commanded and abs(width_m - task.query.hand_width(arm)) > task.values["unforeseen_m"]
    force_n = report.hand_force_n if report.hand_force_n >= task.values["pressing_n"] else 0.0
    grip = [WorldChange(key=f"{arm}.hand_force", value=force_n)] if hand_commanded else []
    return [
        *grip,
        WorldChange(key=f"{arm}.joints", value=list(report.joints)),
        WorldChange(key=f"{arm}.hand_width", value=width_m, validity=Validity.SUSPECT if moves else Validity.VALID),
    ]


def partner_changes(task: AnalyzeTask) -> Changes:
    """The same for the second arm of a primitive; unchanged if nothing was started."""
    partner, report = task.context.partner, task.report
    if not partner or task.step.space != segments.BOTH:
        return []  # only one arm moves in this step, or a camera looks
    if report.partner is None and report.reason in (StopReason.REFUSED, StopReason.BLOCKED):
        return []
    second = report.partner or msgspec.structs.replace(report, joints=[])
    return _reported(task, second, partner, hand_commanded=False)


def pressed_on(task: AnalyzeTask) -> Changes:
    """A close step without an object that presses on something: objects near the hand become suspect.

    They may move with the hand, so their frames are not trusted.
    """
    evaluation, report = task.evaluation, task.report
    if evaluation.step.op != "close" or evaluation.context.object or evaluation.held:
        return []
    if report.hand_force_n < task.values["pressing_n"] or report.hand_width_m < THIN_M:
        return []
    near = []
    for thing in task.query.cell.objects:
        points = [geometry.compose(task.query.frame(thing.name), point.frame.pose) for point in thing.grasp_points]
        if any(geometry.distance(report.tcp_pose, point) < task.values["in_hand_m"] for point in points):
            near.append(thing.name)
    return [WorldChange(key=f"{name}.frame", keep_value=True, validity=Validity.SUSPECT) for name in near]


def touched_object_changes(task: AnalyzeTask, failure: OutcomeClass) -> Changes:
    """After a failure the touched object is suspect until it is sensed again (R151)."""
    thing = task.context.object
    if not thing or thing == task.evaluation.held or task.seen_as_believed:
        return []
    pressed = task.report.peak_force_n > task.values["touched_n"] or not task.query.seat(thing)
    if "object" in failure.suspect or ("if_touched" in failure.suspect and pressed):
        doubtful = ("frame", "grasp") if task.query.held_by(thing) else ("frame",)
        return [WorldChange(key=f"{thing}.{name}", keep_value=True, validity=Validity.SUSPECT) for name in doubtful]
    return []


def target_changes(task: AnalyzeTask) -> Changes:
    """The seat may not be where it is believed to be: an object did not meet it as expected."""
    seat = task.context.target
    if not seat:
        return []
    return [WorldChange(key=f"{seat}.frame", value=task.query.seat_frame(seat).tolist(), validity=Validity.SUSPECT)]


def merged(changes: Changes) -> Changes:
    """One change per fact. A later change that only sets the validity keeps the value of an earlier one."""
    merged: dict[str, WorldChange] = {}
    for change in changes:
        earlier = merged.get(change.key)
        if change.keep_value and earlier is not None and not earlier.keep_value:
            change = msgspec.structs.replace(earlier, validity=change.validity)
        merged[change.key] = change
    return list(merged.values())
