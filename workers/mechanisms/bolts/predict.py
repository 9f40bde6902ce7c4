"""The report that is expected of a driver: at the head of a bolt, and after a turn of its spindle. Pure."""

from __future__ import annotations

import math

import numpy as np

from rtc.protocol.messages import EndReport, EvaluationContext
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import Primitive, SpindleMotion, TorqueAbove, TorqueBelow
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.planning.world_query import WorldQuery
from workers.tasks.report import Course, at_rest, first_s, predicate_of, replaced

# A torque above TWISTS_NM turns a driver between pads that press with 60 N. 3.4 N.m hold them 1.1 to 1.8 mm apart (11).
TWISTS_NM, APART_M = 1.0, 0.0016


def touch_s(query: WorldQuery, arm: str, evaluation: EvaluationContext, course: Course) -> float | None:
    """When the tip of the driver is at the head of the bolt; None of other steps."""
    bolt, tip = evaluation.context.object, _tip(query, arm)
    if tip is None or query.thread(bolt) is None:
        return None
    head = query.frame(bolt)
    return first_s(
        course.duration_s, lambda at_s: bool(geometry.relative(head, geometry.compose(course.tcp(at_s), tip))[2] <= 0)
    )


def _tip(query: WorldQuery, arm: str) -> Array | None:
    """The tip of the spindle of the driver in the hand, in the frame of the tcp; None without a driver."""
    driver = query.driver(arm)
    grasp = query.grasp(driver.name) if driver is not None else None
    if driver is None or driver.spindle is None or grasp is None:
        return None
    return geometry.compose(grasp, driver.spindle.frame.pose)


def of_spindle(query: WorldQuery, made: Primitive, evaluation: EvaluationContext, reason: StopReason) -> EndReport:
    """The hand follows the bolt along its thread. A torque is felt at once outwards, and inwards at the tight place; it
    ends at the end of the thread."""
    turn, arm = made.trajectory, query.model.arms[made.performer]
    assert isinstance(turn, SpindleMotion)
    share = 1.0 if reason in (StopReason.GOAL, StopReason.SLIP) else _turned(query, made, evaluation, reason)
    here, goal, joints = query.tcp(made.performer), evaluation.goal_pose, query.joints(made.performer)
    if goal is not None:
        there = geometry.translate(here, share * (np.asarray(goal[:3]) - here[:3]))
        found = arm.nearest_ik(there.tolist(), joints)
        joints = joints if found is None else [float(angle) for angle in found]
    report = at_rest(query, made.performer, made.id, reason, joints, share * abs(turn.turn_rad) / turn.speed_rad_s)
    when = predicate_of(made, reason)
    apart_m = APART_M if isinstance(when, TorqueAbove) and when.limit_nm > TWISTS_NM else 0.0
    return replaced(report, turned_rad=share * turn.turn_rad, hand_width_m=report.hand_width_m + apart_m)


def _turned(query: WorldQuery, made: Primitive, evaluation: EvaluationContext, reason: StopReason) -> float:
    """The share of a turn of the spindle after which its torque ends it."""
    turn, bolt = made.trajectory, evaluation.context.object
    assert isinstance(turn, SpindleMotion)
    thread, out = query.thread(bolt), query.turns(bolt)
    ends = isinstance(predicate_of(made, reason), TorqueBelow)
    outwards = thread.turns - out if ends and thread is not None else 0.0
    return min(1.0, (out if turn.turn_rad > 0.0 else outwards) * math.tau / abs(turn.turn_rad))
