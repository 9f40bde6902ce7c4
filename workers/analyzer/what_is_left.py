"""What is left of a relative sentence whose step has ended before its amount, as a sentence. Pure."""

from __future__ import annotations

import math

import numpy as np

from rtc.protocol.units import figure
from rtc.spatial import geometry, hinges
from workers.mechanisms import MECHANISMS
from workers.planning.step_target import TURN
from workers.tasks.analyze_task import AnalyzeTask

LEFT = "{left}"
BACK_RAD = 0.1  # a hand that was to turn one way has turned the other way by less


def sentence(task: AnalyzeTask) -> str:
    """The sentence that does the rest; empty if the step is not that of a relative sentence, or nothing is left."""
    rest = task.step.words.rest
    left = _in_words(task) if rest else ""
    return rest.replace(LEFT, left) if left else ""


def nothing(task: AnalyzeTask) -> str:
    """That the step has done the whole amount of a relative sentence; empty if it has not, or there is none."""
    return "nothing is left of it" if task.step.words.rest and _in_words(task) == "" else ""


def _in_words(task: AnalyzeTask) -> str | None:
    """The amount; empty if it is smaller than the tolerance of a goal. None: not known."""
    figures, evaluation, report, values = task.step.figures, task.evaluation, task.report, task.values
    for mechanism in MECHANISMS:
        if (left := mechanism.left(task)) is not None:
            return left
    if figures.width_m is not None:
        return _length(abs(figures.width_m - report.hand_width_m), values["position_m"])
    if (turn := wanted_rad(task)) is not None:
        return _angle(turn - gone_rad(task), values["angle_rad"])
    if evaluation.goal_pose is None or not evaluation.start_joints or not report.tcp_pose:
        return None
    start = task.query.model.arms[evaluation.arm].fk(evaluation.start_joints)
    if figures.by_rad:
        return _angle(geometry.angle(report.tcp_pose, evaluation.goal_pose), values["angle_rad"])
    way = np.asarray(evaluation.goal_pose[:3]) - start[:3]
    length_m = float(np.linalg.norm(way))
    if length_m < values["position_m"]:
        return None
    gone_m = float((np.asarray(report.tcp_pose[:3]) - start[:3]) @ way) / length_m
    return _length(min(length_m, length_m - gone_m), values["position_m"])


def wanted_rad(task: AnalyzeTask) -> float | None:
    """By how much the hand was to turn about a hinge in this step; None of steps that do not end by such a turn."""
    hinged = bool(task.evaluation.held) and task.query.hinge(task.evaluation.held) is not None
    return task.step.overrides.get(TURN) if hinged else None


def gone_rad(task: AnalyzeTask) -> float:
    """By how much the hand has turned the held object about its hinge, in the direction of the step."""
    evaluation, query, held = task.evaluation, task.query, task.evaluation.held
    hinge = query.hinge(held) if held else None
    if hinge is None or not evaluation.start_joints or not task.report.tcp_pose:
        return 0.0
    tcps = (query.model.arms[evaluation.arm].fk(evaluation.start_joints), task.report.tcp_pose)
    home = query.hinge_home(held)
    start, end = (
        hinges.angle_of(home, hinge.axis, frame) for tcp in tcps if (frame := query.in_hand(held, tcp)) is not None
    )
    turn = math.copysign(1.0, task.step.figures.by_rad or 0.0) * (end - start)
    return (turn + BACK_RAD) % math.tau - BACK_RAD


def has_turned(task: AnalyzeTask) -> bool:
    """Whether a step that ends by a turn about a hinge has turned as far. Where the hand is then depends on where the
    hinge truly is."""
    wanted = wanted_rad(task)
    return wanted is not None and gone_rad(task) >= wanted - task.values["angle_rad"]


def _length(left_m: float, least_m: float) -> str:
    return f"{figure(100.0 * left_m)} CM" if left_m > least_m else ""


def _angle(left_rad: float, least_rad: float) -> str:
    return f"{figure(math.degrees(left_rad))} DEG" if left_rad > least_rad else ""
