"""Where an object is between the pads of a hand, and how it may be turned there, from the opening of the hand. Pure.

A bar that is turned about itself or about the approach holds the pads apart, so their opening bounds both angles. Flat
pads turn it flat again, at once or in the next minute: friction decides that. So what a camera has seen of a turned bar
may have passed since (docs/physics.md, "A twisted grip turns flat again").
"""

from __future__ import annotations

import math

from rtc.protocol.messages import HandStep
from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats
from rtc.world.spread import EXACT, Spread, widened
from workers.planning import pose_spread
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import AnalyzeTask

Found = tuple[Array, list[float]]  # frame, spread

# Axes of a grasp point: y = closing direction, z = approach. A held bar can be tilted about x and z.
CLOSING, ABOUT_BAR, ABOUT_APPROACH = 1, 3, 5
ASKEW_RAD = 0.012  # uncertainty of a bar's tilt derived from the hand width
HALF_TURN = geometry.from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, math.pi])  # about the approach
CENTRED_M = 0.001  # uncertainty of the centre between two fingers
STRAIGHT_RAD = 0.005  # the sign of a smaller tilt cannot be measured
# Minimum fraction of a tilted bar's torque that determines the sign. An arm that gives way has shown -0.3.
TWIST = 0.5
OTHER_FACE_RAD = 0.5  # a bar that may be turned by more may lie between the pads with other faces


def between_pads(query: WorldQuery, thing: str, grasp: Floats, spread: Spread, opening_m: float, pad_m: float) -> Found:
    """The pose of a held object in the axes of the tcp, and its spread: each of the two angles is between what it was
    believed to be and zero, and no larger than pads allow that are `pad_m` deep and `opening_m` apart.

    Unchanged: an object that a seat holds too, for it is not free to turn."""
    point, found = query.point_in_hand(thing), (geometry.normalise(grasp), list(spread))
    if point is None or query.seat(thing):
        return found
    bar = point.frame.pose
    offset = geometry.compose(found[0], bar)
    turned_round = abs(geometry.to_rpy(offset)[2]) > 0.5 * math.pi  # the two fingers are alike
    if turned_round:
        offset = geometry.compose(HALF_TURN, offset)
    angles, there = geometry.to_rpy(offset), pose_spread.spread_at(spread, bar)
    apart_m = max(0.0, opening_m - point.width_m) + ASKEW_RAD * pad_m
    most_rad = apart_m / min(pad_m, point.width_m)  # a bar is about as deep as it is wide
    bounds = {}
    for axis in (ABOUT_APPROACH,) if point.round else (ABOUT_BAR, ABOUT_APPROACH):
        believed, half_width = float(angles[axis - 3]), there[axis]
        if abs(believed) + half_width < OTHER_FACE_RAD:
            least = max(-most_rad, min(0.0, believed - half_width))
            most = min(most_rad, max(0.0, believed + half_width))
            angles[axis - 3], bounds[axis] = 0.5 * (least + most), 0.5 * (most - least)
    stands = geometry.from_rpy(offset[:3], angles)
    if turned_round:
        stands = geometry.compose(HALF_TURN, stands)
    after = geometry.normalise(geometry.compose(stands, geometry.inverse(bar)))
    return after, pose_spread.spread_after_measurement(found[0], after, spread, bar, bounds)


def between_fingers(task: AnalyzeTask, moved: Spread = EXACT) -> Found:
    """The fingers press on the bar of the grasp point.

    The bar is centred between the fingers, displaced by its lateral force divided by the stiffness `centre_n_m`. A
    tilted bar widens the opening over the pad length `pad_m` and twists the hand to one side. `moved`: how far the
    closing hand may have moved the object, which remains uncertain along the axes that are not measured.
    """
    before, spread = task.object_frame
    spread = widened(spread, moved)
    point, tcp = task.point.frame.pose, task.report.tcp_pose
    offset = geometry.relative(tcp, geometry.compose(before, point))
    rpy = geometry.to_rpy(offset)
    measured = {CLOSING: CENTRED_M}
    step = task.step.of_kind(HandStep)
    if step.pad_m > 0.0:
        there = pose_spread.spread_at(spread, point)
        (rpy[0], measured[ABOUT_BAR]), (rpy[2], measured[ABOUT_APPROACH]) = _askew(task, step.pad_m, rpy, there)
    aside_m = 0.5 * task.report.wrench[1] / step.centre_n_m if step.centre_n_m > 0.0 else 0.0
    stands = geometry.compose(tcp, geometry.from_rpy([offset[0], aside_m, offset[2]], rpy))
    after = geometry.normalise(geometry.compose(stands, geometry.inverse(point)))
    spread = pose_spread.spread_after_measurement(before, after, spread, point, measured)
    return after, spread


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
