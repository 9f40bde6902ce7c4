"""What an intervention of the operator changes in the world. Pure."""

from __future__ import annotations

import math

import numpy as np

from rtc.protocol.messages import Validity, WorldChange
from rtc.spatial import geometry
from workers.planning import pose_spread
from workers.tasks.analyze_task import AnalyzeTask, Changes
from workers.tasks.flat_grip import HALF_TURN


def handed(task: AnalyzeTask, _: Validity) -> Changes:
    """The operator will move the arm: until it has rested again, no one knows where it is."""
    return [WorldChange(key=f"{task.context.arm}.joints", keep_value=True, validity=Validity.SUSPECT)]


def pointed(task: AnalyzeTask, validity: Validity) -> Changes:
    """The operator has brought the hand to the grasp point (R149): `pointed_m` and `pointed_rad` of the program are how
    well a person sees that.

    The object is turned as the hand is, about each axis about which it may be turned so far. A hand that is turned
    farther is turned itself; so is one about a round bar, and one at an object with a hinge.
    """
    within_m, within_rad = task.values["pointed_m"], task.values["pointed_rad"]
    before, spread = task.object_frame
    point, tcp = task.point.frame.pose, np.asarray(task.report.tcp_pose)
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
    spread = pose_spread.spread_after_measurement(before, after, spread, point, measured)
    key = f"{task.context.object}.frame"
    return [WorldChange(key=key, value=after.tolist(), validity=validity, spread=spread)]
