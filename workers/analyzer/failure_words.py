"""A failure in words: the placeholders of the program, filled in from the report. Pure."""

from __future__ import annotations

import math

from rtc.language.hands import hand_in_words
from rtc.programs.schema import OutcomeClass
from rtc.protocol.messages import EndReport
from rtc.protocol.outcomes import StopReason
from rtc.protocol.sentence import ReflexItem
from rtc.protocol.units import figure
from workers.analyzer.post_conditions import pressing_n, squeezed
from workers.conditions import reflexes
from workers.mechanisms import joined
from workers.tasks.analyze_task import AnalyzeTask

OF_MECHANISMS = joined(lambda mechanism: mechanism.texts)  # placeholder -> its text
UNITS = {StopReason.FORCE_LIMIT: "N", StopReason.CONTACT: "N", StopReason.TORQUE_LIMIT: "N.m", StopReason.TIMEOUT: "s"}


def what_happened(task: AnalyzeTask, reason: StopReason, failure: OutcomeClass, asked: ReflexItem | None) -> str:
    """The failure in words. `asked`: the reflex of the command that has ended the step."""
    words = [_stopped_as_requested(asked, task) if asked else fill_in(_message(failure, task), task, reason)]
    words.append(reflexes.describe_action(task.report))
    if reason is StopReason.OUT_OF_RANGE and task.seen_as_believed:
        words.append("it is where it is believed to be")
    if reason in (StopReason.FORCE_LIMIT, StopReason.CONTACT) and not squeezed(task):
        words.append(task.evaluation.remark)
    return "; ".join(filter(None, words))


def _message(failure: OutcomeClass, task: AnalyzeTask) -> str:
    """The program's message, or that of the report if the program's is about a value that the report lacks."""
    report, words = task.report, failure.message
    of_force = report.reason in (StopReason.FORCE_LIMIT, StopReason.TORQUE_LIMIT)
    measured = "{measured}" in words or (of_force and ("{excess}" in words or "{jam}" in words))
    lacks = (measured and report.measured is None) or ("{limit}" in words and report.limit is None)
    return "{message}" if lacks and report.message else words


def fill_in(message: str, task: AnalyzeTask, reason: StopReason) -> str:
    """The message with its placeholders filled in."""
    for name, text in texts(task, reason).items():
        message = message.replace("{" + name + "}", text)
    return message


def texts(task: AnalyzeTask, reason: StopReason) -> dict[str, str]:
    """The texts of the placeholders, by name. Where a mechanism says nothing, its text is the common one."""
    evaluation, report = task.evaluation, task.report
    own = {name: text(task) for name, text in OF_MECHANISMS.items()}
    least, most = evaluation.width_m or (0.0, 0.0)
    return {
        **own,
        "reason": reason.value,
        "measured": "?" if report.measured is None else figure(report.measured),
        "limit": "the" if report.limit is None else figure(report.limit),
        "unit": UNITS.get(report.reason, ""),
        "message": report.message or evaluation.arm or report.performer,
        "arm": hand_in_words(_stopped_by(task)),
        "camera": report.performer,
        "object": evaluation.body or evaluation.context.object or evaluation.held or "the object",
        "target": evaluation.context.target or "the seat",
        "or_load": f", or {evaluation.held} is heavier than stated and slips" if evaluation.held else "",
        "or_mass": f"; correct the mass of {evaluation.held}, if it is heavier" if evaluation.held else "",
        "point": evaluation.context.grasp_point,
        "width": f"{report.hand_width_m * 1000:.1f}",
        "wanted": f"{least * 1000:.0f} to {most * 1000:.0f}",
        "off": f"{task.off_m * 1000:.1f}",
        "turned": f"{math.degrees(task.turned_rad):.1f}",
        "jam": _jam(report),
        "excess": _excess(task),
        "grip": figure(task.context.limits.grip_force_n or 0.0),
        "short": _short(task),
        "until": task.context.until.sentence if task.context.until else "the condition",
        **{name: text for name, text in own.items() if text},
    }


def _short(task: AnalyzeTask) -> str:
    """How far from its goal a motion has ended, and with what force; empty without a goal or near it."""
    off_m, force_n = task.off_m, pressing_n(task)
    if off_m <= task.values["position_m"]:
        return ""
    pressing = f", and pressed with {figure(force_n)} N" if force_n and task.report.reason is StopReason.TIMEOUT else ""
    return f": the hand was {off_m * 1000:.0f} mm from the end of its path{pressing}"


def _stopped_as_requested(reflex: ReflexItem, task: AnalyzeTask) -> str:
    """Message for a stop by a reflex of the command: the goal is not reached, but there is no fault."""
    value, measured = task.report.measured, ""
    if value is not None:
        by_reason = fill_in("{measured} {unit}", task, task.report.reason).rstrip()
        measured = f" at {reflex.condition.measured_in_words(value) or by_reason}"
    return f"stopped{measured} as asked: {reflexes.reflex_in_words(reflex)}"


def _stopped_by(task: AnalyzeTask) -> str:
    """The arm whose stop function has ended the primitive: of two arms the one with a measured value."""
    second = task.report.partner
    caused = second is not None and second.measured is not None and second.reason is task.report.reason
    return task.context.partner if caused else task.evaluation.arm


def _jam(report: EndReport) -> str:
    """The figures of a jam: a force or torque above its limit, or the distance (m) of a hand behind its path."""
    value, limit, force_n = report.measured or 0.0, report.limit or 0.0, math.hypot(*(report.trip_wrench or [])[:3])
    if report.reason is StopReason.FORCE_LIMIT and not math.isclose(value, force_n, rel_tol=0.01):
        return f"the hand was {value * 1000:.0f} mm behind its path, and pressed with {figure(force_n)} N"
    return f"{figure(value)} {UNITS.get(report.reason, '')} where {figure(limit)} is the limit"


def _excess(task: AnalyzeTask) -> str:
    """What is beyond its limit: a force or torque, or the width of a hand that has reached its goal."""
    report = task.report
    if report.reason not in (StopReason.FORCE_LIMIT, StopReason.TORQUE_LIMIT):
        least, most = (1000 * width_m for width_m in task.evaluation.width_m or (0.0, 0.0))
        return f"the hand is at {1000 * report.hand_width_m:.1f} mm instead of {least:.0f} to {most:.0f} mm"
    unit = UNITS[report.reason]
    if report.measured is None or report.limit is None:
        return f"more {unit} than the limit"
    value = next((text for n in (3, 4, 5) if float(text := figure(report.measured, n)) > report.limit), "more")
    return f"{value} {unit} where {figure(report.limit, 5)} {unit} is the limit"
