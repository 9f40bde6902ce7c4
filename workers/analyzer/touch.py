"""Object localization by touch, from the report of one step and its expected result. Pure.

Each function returns the frame of the step's object (world) and its spread. Axes that a step cannot measure keep their
value. Figures of the measurement (accuracy, pad length) are args of the step, so the script defines them.
"""

from __future__ import annotations

import math

import numpy as np

from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.world.spread import EXACT, Spread, even, widened
from workers.planning import pose_spread
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import AnalyzeTask
from workers.tasks.flat_grip import ABOUT_APPROACH, ABOUT_BAR, ASKEW_RAD, CLOSING, HALF_TURN, Found

ALONG_BAR = (1.0, 0.0, 0.0)
CENTRED_M = 0.001  # uncertainty of the centre between two fingers
STRAIGHT_RAD = 0.005  # the sign of a smaller tilt cannot be measured
# Minimum fraction of a tilted bar's torque that determines the sign. An arm that gives way has shown -0.3.
TWIST = 0.5
NO_TORQUE_NM = 0.02
FREE_M, FREE_RAD = 0.04, 0.25  # how far a closing hand moves and turns a free module: up to 34 mm and 12 deg in physics

CAUGHT_M, CAUGHT_RAD = 0.004, 0.05  # maximum distance from the seated pose at which a catch holds an object
TURNED_M, TURNED_RAD = 0.008, 0.15  # how far a seat moves and turns an object in the hand: up to 4.3 mm and 4.9 deg


def touched(task: AnalyzeTask) -> Found:
    """A contact stopped a straight search; it was expected `beyond_m` before the end.

    `felt_m`: accuracy of the contact. `lever_m`: maximum distance of the contact from the grasp point, which multiplies
    the attitude uncertainty.
    """
    trip = task.report.trip_pose or task.report.tcp_pose
    end, way = _search(task)
    figures = task.step.figures
    later_m = float(np.dot(trip[:3] - end, way)) + (figures.beyond_m or 0.0)
    before, spread = _current(task)
    after = geometry.translate(before, later_m * way)
    point = _point(task)
    axis = int(np.argmax(np.abs(geometry.rotate(geometry.inverse(geometry.compose(before, point)), way))))
    lever_m = figures.lever_m or 0.0
    half_width = (figures.felt_m or 0.0) + lever_m * pose_spread.unsure_across(spread, point, axis)
    return after, pose_spread.spread_after_measurement(before, after, spread, point, {axis: half_width})


def tilted(task: AnalyzeTask) -> Found:
    """The same surface was touched again, `apart_m` farther along the bar than before: its tilt across the bar.

    The first touch has set the position along the search. `tilt_m`: accuracy of the difference of two touches.
    """
    trip = task.report.trip_pose or task.report.tcp_pose
    end, way = _search(task)
    figures = task.step.figures
    later_m, apart_m = float(np.dot(trip[:3] - end, way)) + (figures.beyond_m or 0.0), figures.apart_m or 0.0
    before, spread = _current(task)
    point = _point(task)
    there = geometry.inverse(geometry.compose(before, point))
    about = np.cross(ALONG_BAR, geometry.rotate(there, way))
    axis = int(np.argmax(np.abs(about)))
    first_m = float(geometry.transform_point(there, trip[:3])[0]) - apart_m  # of the first touch, along the bar
    pivot = geometry.compose(point, geometry.from_rpy([first_m, 0.0, 0.0], [0.0, 0.0, 0.0]))
    turn = np.zeros(3)
    turn[axis] = math.copysign(later_m / apart_m, later_m / apart_m * float(about[axis]))
    turned = geometry.compose(geometry.compose(before, pivot), geometry.from_rpy([0.0, 0.0, 0.0], turn))
    after = geometry.normalise(geometry.compose(turned, geometry.inverse(pivot)))
    measured = {3 + axis: (figures.tilt_m or 0.0) / abs(apart_m)}
    return after, pose_spread.spread_after_measurement(before, after, spread, pivot, measured)


def between_fingers(task: AnalyzeTask, moved: Spread = EXACT) -> Found:
    """The fingers press on the bar of the grasp point.

    The bar is centred between the fingers, displaced by its lateral force divided by the stiffness `centre_n_m`. A
    tilted bar widens the opening over the pad length `pad_m` and twists the hand to one side. `moved`: how far the
    closing hand may have moved the object, which remains uncertain along the axes that are not measured.
    """
    before, spread = _current(task)
    spread = widened(spread, moved)
    point, tcp = _point(task), task.report.tcp_pose
    offset = geometry.relative(tcp, geometry.compose(before, point))
    rpy = geometry.to_rpy(offset)
    measured = {CLOSING: CENTRED_M}
    pad_m = task.step.figures.pad_m or 0.0
    if pad_m > 0.0:
        there = pose_spread.spread_at(spread, point)
        (rpy[0], measured[ABOUT_BAR]), (rpy[2], measured[ABOUT_APPROACH]) = _askew(task, pad_m, rpy, there)
    stiffness_n_m = task.step.figures.centre_n_m or 0.0
    aside_m = 0.5 * task.report.wrench[1] / stiffness_n_m if stiffness_n_m > 0.0 else 0.0
    stands = geometry.compose(tcp, geometry.from_rpy([offset[0], aside_m, offset[2]], rpy))
    after = geometry.normalise(geometry.compose(stands, geometry.inverse(point)))
    spread = pose_spread.spread_after_measurement(before, after, spread, point, measured)
    return after, spread


def at_grasp_point(task: AnalyzeTask, within_m: float, within_rad: float) -> Found:
    """A person has brought the hand to the grasp point: `within_m` and `within_rad` are how well a person sees that.

    The object is turned as the hand is, about each axis about which it may be turned so far. A hand that is turned
    farther is turned itself; so is one about a round bar, and one at an object with a hinge.
    """
    before, spread = _current(task)
    point, tcp = _point(task), np.asarray(task.report.tcp_pose)
    offset = geometry.relative(tcp, geometry.compose(before, point))
    if abs(geometry.to_rpy(offset)[2]) > 0.5 * math.pi:  # the two fingers are alike
        tcp = geometry.compose(tcp, HALF_TURN)
        offset = geometry.relative(tcp, geometry.compose(before, point))
    rpy, half_widths = geometry.to_rpy(offset), pose_spread.spread_at(spread, point)[3:]
    hinged = task.query.hinge(task.context.object) is not None
    shown = [
        axis
        for axis in range(3)
        if abs(rpy[axis]) <= half_widths[axis] + within_rad and not hinged and not (axis == 0 and task.point.round)
    ]
    rpy[shown] = 0.0
    stands = geometry.compose(tcp, geometry.from_rpy([0.0, 0.0, 0.0], rpy))
    after = geometry.normalise(geometry.compose(stands, geometry.inverse(point)))
    measured = dict.fromkeys(range(3), within_m) | {3 + axis: within_rad for axis in shown}
    return after, pose_spread.spread_after_measurement(before, after, spread, point, measured)


def moved_by_closing(query: WorldQuery, thing: str) -> Spread:
    """How far a closing hand may move the object along and about each axis: an object in a seat hardly moves."""
    seated = bool(query.seat(thing)) and query.trusts(f"{thing}.seat")
    rests = seated or query.held_by(thing) or query.hinge(thing) or query.cell.object(thing).fixed
    return EXACT if rests else even(FREE_M, FREE_RAD)


def seat_of(task: AnalyzeTask, frame: Array, spread: list[float]) -> Found | None:
    """The frame of the seat that holds the object, up to the play `play_m`.

    None if the object is not seated or the step does not state the play.
    """
    seat, play_m = task.query.seat(task.context.object), task.step.figures.play_m or 0.0
    if not seat or play_m <= 0.0:
        return None
    inside = task.query.cell.seat(seat).module_frame.pose
    place = geometry.normalise(geometry.compose(frame, geometry.inverse(inside)))
    return place, pose_spread.spread_at(widened(spread, even(play_m, 0.0)), geometry.inverse(inside))


def set_down(query: WorldQuery, thing: str, seat: str) -> Found:
    """Pose of an object that was let go of in a seat: from its catch or from the hand, whichever is narrower.

    A catch holds the object near the seated pose. The hand had it where it is, but a seat may have turned it.
    """
    hand = widened(query.spread(f"{thing}.frame"), even(TURNED_M, TURNED_RAD))
    in_seat = query.cell.seat(seat)
    if in_seat.detent_n <= 0.0:
        return query.frame(thing), hand
    bounds = pose_spread.spread_at(query.spread(f"{seat}.frame"), in_seat.module_frame.pose)
    caught = widened(bounds, even(CAUGHT_M, CAUGHT_RAD))
    return min((query.seated_pose(seat), caught), (query.frame(thing), hand), key=lambda found: sum(found[1]))


Tilt = tuple[float, float]  # angle and half-width (rad)


def _askew(task: AnalyzeTask, pad_m: float, rpy: Array, spread: Spread) -> tuple[Tilt, Tilt]:
    """Tilt of the bar against the pads, about the bar (tool x) and about the approach (tool z).

    Both tilts hold the pads apart, each over `pad_m`: the width of the hand gives their sum. The twist of the hand
    gives the signs. `rpy`, `spread`: as believed.
    """
    report = task.report
    width_m = task.point.width_m
    most_rad = max(0.0, report.hand_width_m - width_m) / pad_m
    twists_nm = (report.wrench[3], report.wrench[5]) if report.wrench else (0.0, 0.0)
    clear_nm = TWIST * report.hand_force_n * pad_m
    bar, approach = (float(rpy[0]), spread[ABOUT_BAR]), (float(rpy[2]), spread[ABOUT_APPROACH])
    about_bar = _tilt(most_rad, bar, approach, twists_nm[0], clear_nm)
    return about_bar, _tilt(most_rad, approach, bar, twists_nm[1], clear_nm)


def _tilt(most_rad: float, believed: Tilt, other: Tilt, twist_nm: float, clear_nm: float) -> Tilt:
    """One of two tilts whose absolute values add up to `most_rad`. A twist above `clear_nm` has its sign."""
    its_least, its_most = max(0.0, abs(other[0]) - other[1]), min(most_rad, abs(other[0]) + other[1])
    least, most = max(0.0, most_rad - its_most), max(0.0, most_rad - its_least)
    if most_rad > STRAIGHT_RAD and abs(twist_nm) > clear_nm:
        return math.copysign(0.5 * (least + most), twist_nm), 0.5 * (most - least) + ASKEW_RAD
    near = max(-most, min(most, believed[0]))
    return near, most + abs(near) + ASKEW_RAD


def beyond(task: AnalyzeTask) -> Found:
    """A search ended without contact: the object is assumed `aside_m` farther along it."""
    _, way = _search(task)
    return _shifted(task, (task.step.figures.aside_m or 0.0) * way)


def beside(task: AnalyzeTask) -> Found | None:
    """A contact in front of one finger: the object is assumed `aside_m` to that side. None if neither finger."""
    wrench, trip = task.report.trip_wrench, task.report.trip_pose
    if not wrench or not trip or abs(wrench[3]) < NO_TORQUE_NM:
        return None
    # A force on the finger at +y causes a torque about -x.
    side = -math.copysign(task.step.figures.aside_m or 0.0, wrench[3])
    return _shifted(task, geometry.rotate(trip, [0.0, side, 0.0]))


def _shifted(task: AnalyzeTask, by: Array) -> Found:
    before, spread = _current(task)
    after = geometry.translate(before, by)
    return after, pose_spread.spread_after_measurement(before, after, spread, _point(task), {})


def _current(task: AnalyzeTask) -> Found:
    thing = task.context.object
    return task.query.frame(thing), list(task.query.spread(f"{thing}.frame"))


def _point(task: AnalyzeTask) -> Array:
    return task.point.frame.pose


def _search(task: AnalyzeTask) -> tuple[Array, Array]:
    """End point of the step's straight path (m, world) and its unit direction."""
    evaluation = task.evaluation
    assert evaluation.goal_pose is not None
    assert evaluation.start_joints is not None
    end = np.asarray(evaluation.goal_pose[:3], dtype=float)
    way = end - task.query.model.arms[evaluation.arm].fk(evaluation.start_joints)[:3]
    length = float(np.linalg.norm(way))
    return end, way / length if length > 0.0 else way
