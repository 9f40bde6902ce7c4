"""Whether a step has ended as it should: its post-conditions, and what a report shows beside them. Pure."""

from __future__ import annotations

import math

from rtc.protocol.messages import ArmStep
from rtc.protocol.outcomes import StopReason
from rtc.protocol.sentence import Condition
from rtc.spatial import geometry
from workers.conditions import reflexes
from workers.mechanisms import each, joined
from workers.tasks.analyze_task import AnalyzeTask

ENDS = "ends"  # word of a step that the condition of UNTIL ends
UNMET = "unmet"  # finding of a step that has reached its end before the condition of UNTIL was true
#: effect of a step of a mechanism -> what is wrong with it
VIOLATED = joined(lambda mechanism: mechanism.violated)
HAS_REACHED = each(lambda mechanism: mechanism.has_reached)


STILL_RAD, TRAVEL_RAD = 0.001, 0.02  # turn of a joint that is stuck, and of one that has moved


def violated(task: AnalyzeTask) -> str:
    """The violated post-condition of an end with an expected stop reason; empty if there is none."""
    evaluation, report = task.evaluation, task.report
    if report.reason is StopReason.GOAL and evaluation.no_contact_is_failure:
        return UNMET if evaluation.step.until == ENDS else "nothing_felt"
    if report.reason not in evaluation.step.expect:
        return ""
    until = _until(task)
    if until is not None and not reflexes.has_ended(until, report):
        return "stopped"  # for the same reason, at another figure: a limit of the step
    if (judge := VIOLATED.get(evaluation.step.effect)) is not None:
        return judge(task)
    if until is not None:
        return ""  # it ends where the condition is true
    if evaluation.width_m is not None:
        least, most = evaluation.width_m
        return "narrow" if report.hand_width_m < least else "wide" if report.hand_width_m > most else ""
    step = evaluation.step
    within_m = step.within_m if isinstance(step, ArmStep) else None
    if within_m is not None:  # instead of the tolerance of the program
        there = task.off_m <= within_m or any(has_reached(task) for has_reached in HAS_REACHED)
        return "" if there else "elsewhere"
    if report.reason is StopReason.GOAL and evaluation.goal_pose is not None and not step.presses:
        turned = geometry.angle(report.tcp_pose, evaluation.goal_pose)
        if task.off_m > task.values["position_m"] or turned > task.values["angle_rad"]:
            return "off_goal"
    return ""


def _until(task: AnalyzeTask) -> Condition | None:
    """The condition of the sentence that should have ended this step; None without one."""
    return task.context.until if task.step.until == ENDS else None


def unmoved_joint(task: AnalyzeTask) -> str:
    """The joint that a jammed motion into a seat has not moved although its path needs it; empty if there is none.

    A compliant arm whose joint is stuck does not follow its path, as if the seat were blocked.
    """
    evaluation, report = task.evaluation, task.report
    start, goal = evaluation.start_joints, evaluation.goal_pose
    jammed = report.reason in (StopReason.FORCE_LIMIT, StopReason.TIMEOUT) and evaluation.context.target
    if not jammed or goal is None or not start or len(report.joints) != len(start):
        return ""
    ends = task.query.model.arms[evaluation.arm].nearest_ik(goal, start)
    if ends is None:
        return ""
    moved = [abs(a - b) for a, b in zip(report.joints, start, strict=True)]
    if max(moved) < TRAVEL_RAD:
        return ""  # the arm is back where it began
    needed = [abs(a - b) for a, b in zip(ends, start, strict=True)]
    still = [n for n, rad in enumerate(moved) if rad < STILL_RAD and needed[n] > TRAVEL_RAD]
    names = task.query.cell.arm(evaluation.arm).joints
    return names[max(still, key=needed.__getitem__)] if still else ""


def is_held_askew(task: AnalyzeTask) -> bool:
    """Whether the fingers have closed on the held object, but not to its width: to close them again does not help."""
    evaluation, report = task.evaluation, task.report
    if not evaluation.held or evaluation.width_m is None or report.reason is not StopReason.GOAL:
        return False
    return report.hand_width_m > evaluation.width_m[1]


def squeezed(task: AnalyzeTask) -> bool:
    """Whether fingers that press more than the GRIP-FORCE of the sentence allows have ended the step."""
    report, most_n = task.report, task.evaluation.squeeze_n
    at_limit = report.limit is not None and math.isclose(report.limit, most_n)
    return report.reason is StopReason.FORCE_LIMIT and most_n > 0.0 and at_limit


def pressing_n(task: AnalyzeTask) -> float:
    """The force (N) of an arm that pressed on something when it was stopped; 0 if it did not press."""
    report = task.report
    if report.partner is not None or not report.trip_wrench or task.evaluation.goal_pose is None:
        return 0.0
    force_n = math.hypot(*report.trip_wrench[:3])
    return force_n if force_n >= task.values["touched_n"] else 0.0
