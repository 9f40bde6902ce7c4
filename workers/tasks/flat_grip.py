"""How an object may be turned between the pads of the hand that holds it, from the opening of the hand. Pure.

A bar that is turned about itself or about the approach holds the pads apart, so their opening bounds both angles. Flat
pads turn it flat again, at once or in the next minute: friction decides that. So what a camera has seen of a turned bar
may have passed since (docs/physics.md, "A twisted grip turns flat again").
"""

from __future__ import annotations

import math

from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats
from rtc.world.spread import Spread
from workers.planning import pose_spread
from workers.planning.world_query import WorldQuery

Found = tuple[Array, list[float]]  # frame, spread

# Axes of a grasp point: y = closing direction, z = approach. A held bar can be tilted about x and z.
CLOSING, ABOUT_BAR, ABOUT_APPROACH = 1, 3, 5
ASKEW_RAD = 0.012  # uncertainty of a bar's tilt derived from the hand width
HALF_TURN = geometry.from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, math.pi])  # about the approach
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
