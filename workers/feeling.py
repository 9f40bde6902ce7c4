"""Where a thing is, by what a hand has felt of it: the report of one step, and what was expected. Pure.

Each function gives the frame of the step's object (world) and its spread. What a step cannot feel stays as it was
believed. Figures of the feeling (how exact it is, how long the pads are) are args of the step: they are the script's.
"""

from __future__ import annotations

import math

import numpy as np

from rtc import geometry
from rtc.geometry import Array
from rtc.messages import AnalyzerInput
from rtc.world.spread import even, widened
from workers import known
from workers.belief import WorldQuery

Found = tuple[Array, list[float]]  # frame, spread

# Axes of a grasp point: fingers close along y, z approaches. A bar that is held can stand askew about x and z.
CLOSING, ABOUT_BAR, ABOUT_APPROACH = 1, 3, 5
CENTRED_M = 0.001  # how well the middle between two fingers is known
ASKEW_RAD = 0.012  # how well the width of a hand tells how a bar stands in it
STRAIGHT_RAD = 0.005  # less shows no side
TWIST = 0.25  # of the torque that a bar askew gives, to be sure of its sign
NO_TORQUE_NM = 0.02


def touched(query: WorldQuery, data: AnalyzerInput) -> Found:
    """A straight search was stopped by a touch, which was expected `beyond_m` before its end. `felt_m`: how exact that
    is; `lever_m`: how far from the grasp point the touch may have been, where attitude counts."""
    trip = data.report.trip_pose or data.report.tcp_pose
    end, way = _search(query, data)
    later_m = float(np.dot(trip[:3] - end, way)) + _figure(data, "beyond_m")
    before, spread = _believed(query, data)
    after = geometry.translate(before, later_m * way)
    point = _point(query, data)
    along = geometry.rotate(geometry.inverse(geometry.compose(before, point)), way)
    axis = int(np.argmax(np.abs(along)))
    unsure_rad = known.uncertainty_figures(spread, point)["unsure_rad"]
    half_width = _figure(data, "felt_m") + _figure(data, "lever_m") * unsure_rad
    return after, known.spread_after_measurement(before, after, spread, point, {axis: half_width})


def between_fingers(query: WorldQuery, data: AnalyzerInput) -> Found:
    """The fingers press on the grasp point's bar: it is in the middle between them, or as far beside it as it pushes
    the hand aside (`centre_n_m`: how stiffly the fingers keep to the middle). If it stood askew, they would stand wider
    apart (over a pad of `pad_m`), and the bar would twist the hand to one side."""
    before, spread = _believed(query, data)
    point, tcp = _point(query, data), data.report.tcp_pose
    offset = geometry.relative(tcp, geometry.compose(before, point))
    rpy = geometry.to_rpy(offset)
    measured = {CLOSING: CENTRED_M}
    pad_m = _figure(data, "pad_m")
    if pad_m > 0.0:
        rpy[0], half_width = _askew(query, data, pad_m, float(rpy[0]))
        measured |= {ABOUT_BAR: half_width, ABOUT_APPROACH: half_width + abs(float(rpy[2]))}
    stiffness_n_m = _figure(data, "centre_n_m")
    aside_m = 0.5 * data.report.wrench[1] / stiffness_n_m if stiffness_n_m > 0.0 else 0.0
    stands = geometry.compose(tcp, geometry.from_rpy([offset[0], aside_m, offset[2]], rpy))
    after = geometry.normalise(geometry.compose(stands, geometry.inverse(point)))
    spread = known.spread_after_measurement(before, after, spread, point, measured)
    return after, spread


def seat_of(query: WorldQuery, data: AnalyzerInput, frame: Array, spread: list[float]) -> Found | None:
    """Where the seat is that the thing sits in: it was as far off as the thing, but for the play of `play_m` in it.
    None: the thing sits in none, or the step does not say what play there is."""
    seat, play_m = query.seat(data.evaluation.context.object), _figure(data, "play_m")
    if not seat or play_m <= 0.0:
        return None
    inside = query.cell.seat(seat).module_frame.pose
    place = geometry.normalise(geometry.compose(frame, geometry.inverse(inside)))
    return place, known.spread_at(widened(spread, even(play_m, 0.0)), geometry.inverse(inside))


def _askew(query: WorldQuery, data: AnalyzerInput, pad_m: float, believed_rad: float) -> tuple[float, float]:
    """How the bar is turned about the tool's x axis against the pads (rad), and how well that is known."""
    report = data.report
    width_m = query.cell.object(data.evaluation.context.object).grasp_point(data.evaluation.context.grasp_point).width_m
    most_rad = max(0.0, report.hand_width_m - width_m) / pad_m
    twist_nm = report.wrench[3] if report.wrench else 0.0
    if most_rad > STRAIGHT_RAD and abs(twist_nm) > TWIST * report.hand_force_n * pad_m:
        return math.copysign(most_rad, twist_nm), ASKEW_RAD
    near = max(-most_rad, min(most_rad, believed_rad))
    return near, most_rad + abs(near) + ASKEW_RAD


def beyond(query: WorldQuery, data: AnalyzerInput) -> Found:
    """Nothing was felt up to the end of a search: the thing is believed `aside_m` farther on."""
    _, way = _search(query, data)
    return _shifted(query, data, _figure(data, "aside_m") * way)


def beside(query: WorldQuery, data: AnalyzerInput) -> Found | None:
    """A touch in front of one finger: the thing is believed `aside_m` to that side. None: in front of neither."""
    wrench, trip = data.report.trip_wrench, data.report.trip_pose
    if not wrench or not trip or abs(wrench[3]) < NO_TORQUE_NM:
        return None
    side = -math.copysign(_figure(data, "aside_m"), wrench[3])  # a push on the finger at +y turns about -x
    return _shifted(query, data, geometry.rotate(trip, [0.0, side, 0.0]))


def _shifted(query: WorldQuery, data: AnalyzerInput, by: Array) -> Found:
    before, spread = _believed(query, data)
    after = geometry.translate(before, by)
    return after, known.spread_after_measurement(before, after, spread, _point(query, data), {})


def _believed(query: WorldQuery, data: AnalyzerInput) -> Found:
    thing = data.evaluation.context.object
    return query.frame(thing), list(query.spread(f"{thing}.frame"))


def _point(query: WorldQuery, data: AnalyzerInput) -> Array:
    context = data.evaluation.context
    return query.cell.object(context.object).grasp_point(context.grasp_point).frame.pose


def _search(query: WorldQuery, data: AnalyzerInput) -> tuple[Array, Array]:
    """The end of the step's straight way (m, world), and its direction."""
    evaluation = data.evaluation
    assert evaluation.goal_pose is not None
    assert evaluation.start_joints is not None
    end = np.asarray(evaluation.goal_pose[:3], dtype=float)
    way = end - query.model.arms[evaluation.arm].fk(evaluation.start_joints)[:3]
    length = float(np.linalg.norm(way))
    return end, way / length if length > 0.0 else way


def _figure(data: AnalyzerInput, name: str) -> float:
    """A number of the step's args; 0 when it is not there."""
    value = data.evaluation.step.args.get(name, 0.0)
    return 0.0 if isinstance(value, str) else value
