"""What the binder predicted of a step, against what was reported (R79, R146). Pure.

A figure is compared if the step ended as expected. One that left its band is a drift: nothing failed, but a person sees
it, and a grip that weakens is corrected before it fails.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from operator import mul

from rtc.programs.compatibility import row_of
from rtc.protocol.messages import ArmStep, ProcedureStep
from rtc.protocol.outcomes import OF_OPERATOR, Compared, Figure, StopReason
from rtc.world.spread import EXACT
from workers.tasks.analyze_task import AnalyzeTask, Changes

Finding = tuple[float, float, float]  # predicted, measured, half-width of the band
GRIP = frozenset({"hand_width_m", "hand_force_n"})  # figures of a hand that keeps what it holds

#: figures that the program must define
VALUES = ("late_factor", "late_s", "off_factor", "near_factor", "slid_m", "weaker_factor")


def compared(task: AnalyzeTask, changes: Changes) -> Compared | None:
    """The figures of a step that ended as expected; None if nothing was predicted of it."""
    figures = []
    for name, compute in FIGURES.items():
        if (finding := compute(task, changes)) is not None:
            figures.append(Figure(name, *finding))
    return Compared(task.context.verb, row_of(task.step), figures, task.step.label) if figures else None


def unexpected(task: AnalyzeTask) -> Compared | None:
    """The same for a step that ended otherwise: it has no figures."""
    return Compared(task.context.verb, row_of(task.step)) if task.evaluation.predicted_s else None


def in_words(drifts: Iterable[Figure]) -> str:
    """Figures outside their bands."""
    return "; ".join(WORDS[figure.name](figure) for figure in drifts)


# --- figures -----------------------------------------------------------------------------------------------


def _duration(task: AnalyzeTask, _: Changes) -> Finding | None:
    """Of an arm or a hand: a camera takes the time that its computer needs, the operator any time. A
    pause is not counted."""
    evaluation, report = task.evaluation, task.report
    if evaluation.body or not evaluation.predicted_s or report.reason in OF_OPERATOR:
        return None
    band_s = max(task.values["late_s"], task.values["late_factor"] * evaluation.predicted_s)
    return evaluation.predicted_s, report.duration_s - report.paused_s, evaluation.within_s + band_s


def _off(task: AnalyzeTask, _: Changes) -> Finding | None:
    """Distance of the tcp from the goal, where a greater one would be a failure."""
    goal, pose, step = task.evaluation.goal_pose, task.report.tcp_pose, task.step
    if not _reached(task) or goal is None or not pose or not isinstance(step, ArmStep) or step.presses:
        return None
    within_m = step.within_m or task.values["position_m"]
    return 0.0, math.dist(goal[:3], pose[:3]), task.values["off_factor"] * within_m


def _turned(task: AnalyzeTask, _: Changes) -> Finding | None:
    """Angle between the tcp and the goal; a compliant hand gives way."""
    goal, pose = task.evaluation.goal_pose, task.report.tcp_pose
    if not _reached(task) or goal is None or not pose or task.step.complies:
        return None
    turned = 2.0 * math.acos(min(1.0, abs(sum(map(mul, goal[3:], pose[3:])))))
    return 0.0, turned, task.values["off_factor"] * task.values["angle_rad"]


def _force(task: AnalyzeTask, _: Changes) -> Finding | None:
    """Greatest force at the wrist: near the limit at which the step would have failed."""
    limit_n = task.evaluation.force_n
    return (0.0, task.report.peak_force_n, task.values["near_factor"] * limit_n) if limit_n else None


def _hand_width(task: AnalyzeTask, _: Changes) -> Finding | None:
    """Width of a hand that keeps what it holds."""
    if not _keeps(task):
        return None
    return task.query.hand_width(task.evaluation.arm), task.report.hand_width_m, task.values["slid_m"]


def _hand_force(task: AnalyzeTask, _: Changes) -> Finding | None:
    """Force of the same; a greater one is no drift."""
    if not _keeps(task) or not (force_n := task.query.hand_force(task.evaluation.arm)):
        return None
    return force_n, min(force_n, task.report.hand_force_n), task.values["weaker_factor"] * force_n


def _found(task: AnalyzeTask, changes: Changes) -> Finding | None:
    """How far a body that the step has sensed was from where it was believed to be; the band is its spread."""
    body = task.evaluation.body or task.context.object
    if not task.step.effect or not body or body == task.evaluation.held:
        return None
    key = f"{body}.frame"
    change = next((one for one in changes if one.key == key and not one.keep_value), None)
    fact = task.query.world.get(key)
    if change is None or fact is None or fact.value is None:
        return None
    bounds = (fact.spread or EXACT)[:3], (change.spread or EXACT)[:3]
    return 0.0, math.dist(fact.value[:3], change.value[:3]), math.hypot(*bounds[0]) + math.hypot(*bounds[1])


def _reached(task: AnalyzeTask) -> bool:
    return task.report.reason is StopReason.GOAL


def _keeps(task: AnalyzeTask) -> bool:
    """Whether the hand had something in it that it neither took nor let go in this step."""
    step = task.step
    return bool(task.evaluation.held and task.report.joints) and not step.op and not isinstance(step, ProcedureStep)


FIGURES: dict[str, Callable[[AnalyzeTask, Changes], Finding | None]] = {
    "duration_s": _duration,
    "off_goal_m": _off,
    "turned_rad": _turned,
    "force_n": _force,
    "hand_width_m": _hand_width,
    "hand_force_n": _hand_force,
    "found_m": _found,
}


def _mm(value: float) -> str:
    return f"{1e3 * value:.1f} mm"


WORDS: dict[str, Callable[[Figure], str]] = {
    "duration_s": lambda one: f"took {one.measured:.2f} s, predicted {one.predicted:.2f} +- {one.band:.2f} s",
    "off_goal_m": lambda one: f"ended {_mm(one.measured)} from the goal; {_mm(one.band)} is usual",
    "turned_rad": lambda one: f"ended {math.degrees(one.measured):.1f} deg from the goal",
    "force_n": lambda one: f"{one.measured:.1f} N at the wrist, near the limit of the step",
    "hand_width_m": lambda one: f"the hand is at {_mm(one.measured)}, it was at {_mm(one.predicted)}",
    "hand_force_n": lambda one: f"the hand grips with {one.measured:.1f} N, it was {one.predicted:.1f} N",
    "found_m": lambda one: f"{_mm(one.measured)} from where it was believed to be, known within {_mm(one.band)}",
}
