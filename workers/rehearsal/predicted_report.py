"""The end report that a primitive is expected to get: the reason its step expects, at the place where it expects it.

Pure. An arm follows its path exactly. A touch is felt where the step looks for it, a hand closes on the object of its
step, and a camera sees the body where it is believed to be.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rtc.protocol.messages import BoundStep, EndReport, EvaluationContext, MoveStep, WorldChange
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import (
    Coupling,
    ForceAbove,
    HoldStill,
    JointTrajectory,
    Primitive,
    TimeAbove,
    TorqueAbove,
)
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.mechanisms import each, joined
from workers.planning.world_query import WorldQuery
from workers.tasks.report import Course, at_rest, curve, first_s, predicate_of, replaced

BEYOND = 1.05  # what trips a stop function, as a multiple of its limit

TOUCH_S, REACHED_S = each(lambda mechanism: mechanism.touch_s), each(lambda mechanism: mechanism.reached_s)
FEELS = joined(lambda mechanism: mechanism.feels)


def end_report(query: WorldQuery, bound: BoundStep, now_s: float, reason: StopReason | None = None) -> EndReport:
    """The report on a bound step that begins at `now_s`. `reason`: that it ends with, instead of the expected one.
    Raises Refused: an operator could not do what is asked."""
    made, evaluation = bound.primitive, bound.evaluation
    assert made is not None
    assert evaluation is not None
    ends = reason or evaluation.step.expect[0]  # the likely one comes first
    report = REPORTS[type(made.trajectory)](query, made, evaluation, ends)
    measured, limit = tripped(made, ends)
    report = replaced(
        report,
        at_s=now_s + report.duration_s,
        measured=measured,
        limit=limit,
        peak_force_n=measured or 0.0 if isinstance(predicate_of(made, ends), ForceAbove) else 0.0,
        peak_torque_nm=measured or 0.0 if isinstance(predicate_of(made, ends), TorqueAbove) else 0.0,
    )
    feels = FEELS.get(evaluation.step.effect)
    return feels(query, evaluation, report) if feels is not None and ends is StopReason.GOAL else report


def tripped(made: Primitive, reason: StopReason) -> tuple[float | None, float | None]:
    """(measured value, limit) of the stop function with this reason; None without a limit."""
    when = predicate_of(made, reason)
    for name in getattr(when, "__struct_fields__", ()):
        if name.startswith(("limit_", "margin_")):
            limit = float(getattr(when, name))
            return BEYOND * limit, limit
    return None, None


# --- arms --------------------------------------------------------------------------------------------------


def _of_path(query: WorldQuery, made: Primitive, evaluation: EvaluationContext, reason: StopReason) -> EndReport:
    """At the end of the path, or where a touch is expected: `beyond_m` before it. Another end: on half of the way."""
    path = made.trajectory
    assert isinstance(path, JointTrajectory)
    if reason in (StopReason.GOAL, StopReason.NO_CONTACT):
        at_s = next((at_s for reached_s in REACHED_S if (at_s := reached_s(query, made)) is not None), path.duration_s)
    elif reason is StopReason.CONTACT and reason in evaluation.step.expect:
        at_s = _touch_s(query, made.performer, path, evaluation)
    elif reason in (StopReason.REFUSED, StopReason.BLOCKED):
        at_s = 0.0
    else:
        at_s = 0.5 * path.duration_s
    takes_s = at_s
    if reason is StopReason.GOAL:
        takes_s = evaluation.predicted_s  # an arm that lags is there at the end
    elif reason is StopReason.CONTACT and reason in evaluation.step.expect:
        takes_s += _unloads_s(evaluation, path.duration_s)
    report = at_rest(query, made.performer, made.id, reason, _posture(path, at_s), takes_s)
    if made.partner is None:
        return report
    second = made.partner
    posture = _posture(second.trajectory, min(at_s, second.trajectory.duration_s))
    return replaced(report, partner=at_rest(query, second.performer, made.id, reason, posture, at_s))


def _unloads_s(evaluation: EvaluationContext, path_s: float) -> float:
    """From the touch that a step expects until its arm presses on nothing: what the binder has predicted (`of_path`)
    beyond the time of the touch itself."""
    if StopReason.GOAL in evaluation.step.expect:
        return 0.0
    return max(0.0, evaluation.predicted_s + evaluation.within_s - path_s)


def _posture(path: JointTrajectory, at_s: float) -> list[float]:
    if at_s >= path.duration_s:
        return path.positions[-1]
    found: list[float] = curve(path).at(np.array([at_s]))[0, 0].tolist()
    return found


def _touch_s(query: WorldQuery, arm: str, path: JointTrajectory, evaluation: EvaluationContext) -> float:
    """When an expected touch is felt: where a mechanism says, or `beyond_m` of the step before the end."""
    joints, fk = curve(path), query.model.arms[arm].fk

    def tcp(at_s: float) -> Array:
        return fk(joints.at(np.array([at_s]))[0, 0])

    course = Course(tcp, path.duration_s)
    for touch_s in TOUCH_S:
        if (felt_s := touch_s(query, arm, evaluation, course)) is not None:
            return felt_s
    step, end = evaluation.step, fk(path.positions[-1])
    beyond_m = step.beyond_m if isinstance(step, MoveStep) else 0.0
    return first_s(path.duration_s, lambda at_s: geometry.distance(tcp(at_s), end) <= beyond_m)


def _of_rest(query: WorldQuery, made: Primitive, evaluation: EvaluationContext, reason: StopReason) -> EndReport:
    rests_s = evaluation.predicted_s
    if isinstance(made.trajectory, HoldStill) and made.trajectory.duration_s is None:
        rests_s = next(stop.when.limit_s for stop in made.stop_functions if isinstance(stop.when, TimeAbove))
    return at_rest(query, made.performer, made.id, reason, query.joints(made.performer), rests_s)


def _of_coupling(query: WorldQuery, made: Primitive, evaluation: EvaluationContext, reason: StopReason) -> EndReport:
    """The arm is the one with the hand from then on: another tcp, and open fingers. One that lets go of it has the jaws
    of its coupler closed on it."""
    coupling, arm = made.trajectory, made.performer
    assert isinstance(coupling, Coupling)
    report = at_rest(query, arm, made.id, reason, query.joints(arm), evaluation.predicted_s)
    before = query.hand(arm)
    if reason is not StopReason.GOAL or coupling.hand == before:
        return report
    after = query.after([WorldChange(key=f"{arm}.hand", value=coupling.hand)])
    width_m, pose = after.cell.arm(arm).gripper.max_opening_m, after.tcp(arm).tolist()
    if before:
        laid = next(hand for hand in after.cell.arm(arm).hands if hand.name == before)
        width_m = after.cell.object(before).grasp_point(laid.coupling).width_m
    return replaced(report, hand=coupling.hand, hand_width_m=width_m, hand_force_n=0.0, tcp_pose=pose, trip_pose=pose)


REPORTS: dict[type, Callable[[WorldQuery, Primitive, EvaluationContext, StopReason], EndReport]] = {
    JointTrajectory: _of_path,
    HoldStill: _of_rest,
    Coupling: _of_coupling,
    **joined(lambda mechanism: mechanism.reports),
}
