"""Where an object is by touch, from the report of one step and its expected result. Pure.

Each measurement returns the frame of the step's object (world) and its spread. Axes that a step cannot measure keep
their value. Figures of the measurement (accuracy, pad length) are args of the step, so the script defines them.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from rtc.protocol.messages import MoveStep, Validity, WorldChange
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.planning import pose_spread
from workers.tasks.analyze_task import AnalyzeTask
from workers.tasks.flat_grip import Found

ALONG_BAR = (1.0, 0.0, 0.0)
NO_TORQUE_NM = 0.02


def found_by(
    measure: Callable[[AnalyzeTask], Found | None],
) -> Callable[[AnalyzeTask, Validity], list[WorldChange]]:
    """The effect of a step that places its object by this measurement; nothing changes if that finds nothing."""

    def changes(task: AnalyzeTask, validity: Validity) -> list[WorldChange]:
        if (found := measure(task)) is None:
            return []
        key = f"{task.context.object}.frame"
        return [WorldChange(key=key, value=found[0].tolist(), validity=validity, spread=found[1])]

    changes.__doc__ = measure.__doc__
    return changes


def touched(task: AnalyzeTask) -> Found:
    """A contact stopped a straight search; it was expected `beyond_m` before the end.

    `felt_m`: accuracy of the contact. `lever_m`: maximum distance of the contact from the grasp point, which multiplies
    the attitude uncertainty.
    """
    trip = task.report.trip_pose or task.report.tcp_pose
    end, way = _search(task)
    step = task.step.of_kind(MoveStep)
    later_m = float(np.dot(trip[:3] - end, way)) + step.beyond_m
    before, spread = task.object_frame
    after = geometry.translate(before, later_m * way)
    point = task.point.frame.pose
    axis = int(np.argmax(np.abs(geometry.rotate(geometry.inverse(geometry.compose(before, point)), way))))
    half_width = step.felt_m + step.lever_m * pose_spread.unsure_across(spread, point, axis)
    return after, pose_spread.spread_after_measurement(before, after, spread, point, {axis: half_width})


def tilted(task: AnalyzeTask) -> Found:
    """The same surface was touched again, `apart_m` farther along the bar than before: its tilt across the bar.

    The first touch has set the position along the search. `tilt_m`: accuracy of the difference of two touches.
    """
    trip = task.report.trip_pose or task.report.tcp_pose
    end, way = _search(task)
    step = task.step.of_kind(MoveStep)
    later_m, apart_m = float(np.dot(trip[:3] - end, way)) + step.beyond_m, step.apart_m
    before, spread = task.object_frame
    point = task.point.frame.pose
    there = geometry.inverse(geometry.compose(before, point))
    about = np.cross(ALONG_BAR, geometry.rotate(there, way))
    axis = int(np.argmax(np.abs(about)))
    first_m = float(geometry.transform_point(there, trip[:3])[0]) - apart_m  # of the first touch, along the bar
    pivot = geometry.compose(point, geometry.from_rpy([first_m, 0.0, 0.0], [0.0, 0.0, 0.0]))
    turn = np.zeros(3)
    turn[axis] = math.copysign(later_m / apart_m, later_m / apart_m * float(about[axis]))
    turned = geometry.compose(geometry.compose(before, pivot), geometry.from_rpy([0.0, 0.0, 0.0], turn))
    after = geometry.normalise(geometry.compose(turned, geometry.inverse(pivot)))
    measured = {3 + axis: step.tilt_m / abs(apart_m)}
    return after, pose_spread.spread_after_measurement(before, after, spread, pivot, measured)


def beyond(task: AnalyzeTask) -> Found:
    """A search ended without contact: the object is assumed `aside_m` farther along it."""
    _, way = _search(task)
    return _shifted(task, task.step.of_kind(MoveStep).aside_m * way)


def beside(task: AnalyzeTask) -> Found | None:
    """A contact in front of one finger: the object is assumed `aside_m` to that side. None if neither finger."""
    wrench, trip = task.report.trip_wrench, task.report.trip_pose
    if not wrench or not trip or abs(wrench[3]) < NO_TORQUE_NM:
        return None
    # A force on the finger at +y causes a torque about -x.
    side = -math.copysign(task.step.of_kind(MoveStep).aside_m, wrench[3])
    return _shifted(task, geometry.rotate(trip, [0.0, side, 0.0]))


def _shifted(task: AnalyzeTask, by: Array) -> Found:
    before, spread = task.object_frame
    after = geometry.translate(before, by)
    return after, pose_spread.spread_after_measurement(before, after, spread, task.point.frame.pose, {})


def _search(task: AnalyzeTask) -> tuple[Array, Array]:
    """End point of the step's straight path (m, world) and its unit direction."""
    evaluation = task.evaluation
    assert evaluation.goal_pose is not None
    assert evaluation.start_joints is not None
    end = np.asarray(evaluation.goal_pose[:3], dtype=float)
    way = end - task.query.model.arms[evaluation.arm].fk(evaluation.start_joints)[:3]
    length = float(np.linalg.norm(way))
    return end, way / length if length > 0.0 else way
