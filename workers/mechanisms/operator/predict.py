"""The report that is expected of an intervention of the operator: what is asked is done. Pure."""

from __future__ import annotations

import math

import numpy as np

from rtc.protocol.messages import EndReport, EvaluationContext
from rtc.protocol.outcomes import RefusalReason, Refused, StopReason
from rtc.protocol.primitive import Primitive, TeleopMotion
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.conditions.prediction import closes_on_m
from workers.planning.world_query import WorldQuery
from workers.tasks.report import at_rest, replaced


def of_operated(query: WorldQuery, made: Primitive, evaluation: EvaluationContext, reason: StopReason) -> EndReport:
    """Only a shared path takes a time that is known. Raises Refused."""
    asked, name = made.trajectory, made.performer
    assert isinstance(asked, TeleopMotion)
    done = reason is StopReason.OPERATOR_DONE
    joints, takes_s = query.joints(name), 0.0
    if done and asked.along is not None:
        joints, takes_s = asked.along.positions[-1], asked.along.duration_s
    elif done and evaluation.goal_pose is not None:
        joints = _joints_at(query, name, _followed(query, asked, evaluation, evaluation.goal_pose))
    report = at_rest(query, name, made.id, reason, joints, takes_s)
    if not done:
        return report
    if asked.hand:
        report = replaced(report, hand_width_m=closes_on_m(query, evaluation), hand_force_n=asked.grip_n)
    return replaced(report, turned_rad=asked.turn_rad)


def _followed(query: WorldQuery, asked: TeleopMotion, evaluation: EvaluationContext, goal: list[float]) -> Array:
    """The pose of the tcp, which follows the head of a bolt that is turned along its thread."""
    thread = query.thread(evaluation.context.object) if asked.spindle else None
    out_m = -asked.turn_rad / math.tau * thread.pitch_m if thread is not None else 0.0
    return geometry.compose(np.array(goal), np.array([0.0, 0.0, -out_m, 0.0, 0.0, 0.0, 1.0]))


def _joints_at(query: WorldQuery, arm: str, pose: Array) -> list[float]:
    found = query.model.arms[arm].nearest_ik(pose.tolist(), query.joints(arm))
    if found is None:
        message = f"{arm} does not reach where the operator is asked to move it"
        raise Refused.because(RefusalReason.INFEASIBLE, message, where=arm, clears="the other arm, or another place")
    return [float(angle) for angle in found]
