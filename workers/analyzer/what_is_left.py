"""What is left of a relative sentence whose step has ended before its amount, as a sentence. Pure."""

from __future__ import annotations

import math

import numpy as np

from rtc.protocol.messages import CircleStep, HandStep, MoveStep
from rtc.protocol.units import figure
from rtc.spatial import geometry
from workers.mechanisms import each
from workers.tasks.analyze_task import AnalyzeTask

LEFT = "{left}"
LEFT_OF = each(lambda mechanism: mechanism.left)


def sentence(task: AnalyzeTask) -> str:
    """The sentence that does the rest; empty if the step is not that of a relative sentence, or nothing is left."""
    rest = task.step.rest
    left = _in_words(task) if rest else ""
    return rest.replace(LEFT, left) if left else ""


def nothing(task: AnalyzeTask) -> str:
    """That the step has done the whole amount of a relative sentence; empty if it has not, or there is none."""
    return "nothing is left of it" if task.step.rest and _in_words(task) == "" else ""


def _in_words(task: AnalyzeTask) -> str | None:
    """The amount; empty if it is smaller than the tolerance of a goal. None: not known."""
    step, evaluation, report, values = task.step, task.evaluation, task.report, task.values
    for left_of in LEFT_OF:
        if (left := left_of(task)) is not None:
            return left
    if isinstance(step, HandStep) and step.width_m is not None:
        return _length(abs(step.width_m - report.hand_width_m), values["position_m"])
    if evaluation.goal_pose is None or not evaluation.start_joints or not report.tcp_pose:
        return None
    start = task.query.model.arms[evaluation.arm].fk(evaluation.start_joints)
    if isinstance(step, MoveStep | CircleStep) and step.by_rad:
        return _angle(geometry.angle(report.tcp_pose, evaluation.goal_pose), values["angle_rad"])
    way = np.asarray(evaluation.goal_pose[:3]) - start[:3]
    length_m = float(np.linalg.norm(way))
    if length_m < values["position_m"]:
        return None
    gone_m = float((np.asarray(report.tcp_pose[:3]) - start[:3]) @ way) / length_m
    return _length(min(length_m, length_m - gone_m), values["position_m"])


def _length(left_m: float, least_m: float) -> str:
    return f"{figure(100.0 * left_m)} CM" if left_m > least_m else ""


def _angle(left_rad: float, least_rad: float) -> str:
    return f"{figure(math.degrees(left_rad))} DEG" if left_rad > least_rad else ""
