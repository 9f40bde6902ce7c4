"""UNLESS condition THEN action, converted to stop functions of the motion loop (A8). Pure.

`refuse_unsupported` rejects conditions that no sensor measures and actions that no reflex performs, before any motion.
`stop_functions` is valid only for reflexes that it accepted. A limit along an axis applies in both directions. BELOW
and NO-CONTACT become true after the value has been above the limit in the same step, because every motion begins
without force. DISTANCE is that to the object of the command; without one, EXCEEDS measures from the start of the step.

The force and torque limits of the step (`StepState.overloads`) do not prevent a reflex of the command. A hand that
exceeds one has touched something unplanned: this is a COLLISION too. A reflex that takes the force away acts at the
limit if its own figure is higher; RELEASE, which drops the object, does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import msgspec

from rtc.protocol import causes
from rtc.protocol.messages import EndReport
from rtc.protocol.outcomes import Reflex, RefusalReason, Refused, StopReason
from rtc.protocol.primitive import (
    BodyTouch,
    ClearanceBelow,
    ForceAbove,
    ForceBelow,
    GripForceAbove,
    GripForceBelow,
    HandWidthBelow,
    JointMarginBelow,
    JointTurnAbove,
    NoProgress,
    Predicate,
    ReportCondition,
    StopFunction,
    TcpFar,
    TcpNear,
    TimeAbove,
    TorqueAbove,
    TorqueBelow,
    TurnAbove,
    Vector,
)
from rtc.protocol.sentence import Condition, ReflexItem
from rtc.protocol.units import in_words
from rtc.spatial import geometry
from rtc.spatial.axis_names import AXES
from rtc.spatial.geometry import Array
from workers.planning import axes, suggestions

JOINT = "JOINT-"  # and its number from the base, from 1: a direction of TURN
SHARE = 0.8  # of the limit, that an advised condition has
TURNED_DEG = 0.05  # a smaller turn of a back-off is not stated
#: conditions about what is between the fingers
HELD = frozenset({"SLIP", "OBJECT-LOST"})
Overload = ForceAbove | TorqueAbove
EASING = frozenset({Reflex.BACK_OFF, Reflex.COMPLY})  # reflexes that take the force away: at least as safe as STOP
ACTIONS: dict[str, Reflex] = {
    "stop": Reflex.STOP,
    "back_off": Reflex.BACK_OFF,
    "comply": Reflex.COMPLY,
    "release": Reflex.RELEASE,
}


@dataclass(frozen=True)
class StepState:
    """State of a step at binding: figures in force, tcp pose (world), position of the command's object (world, m)."""

    values: dict[str, float]  # contact_n, lost_contact_n, joint_margin_rad, time_limit_s, held_width_m, jam_m ...
    hand_pose: Array
    holding: bool
    object_at: list[float] | None
    closing: bool  # the step closes the hand
    beside: list[Vector]  # balls [x y z radius] round what the command may come near to
    overloads: list[Overload]  # force and torque limits of the step itself
    slips: list[Predicate]  # of the step itself: what it turns has come off
    spindle: Vector | None  # the axis about which the step turns a bolt (tool frame): TORQUE is that about it


Maker = Callable[[Condition, StepState], list[Predicate]]


def _contact(_: Condition, state: StepState) -> list[Predicate]:
    return [ForceAbove(limit_n=state.values.get("contact_n", state.values["feel_force_n"]))]


def _no_contact(_: Condition, state: StepState) -> list[Predicate]:
    felt_n = state.values.get("contact_n", state.values["feel_force_n"])
    return [ForceBelow(limit_n=min(state.values["lost_contact_n"], 0.5 * felt_n), armed_n=felt_n)]


def _slip(_: Condition, state: StepState) -> list[Predicate]:
    return [*_weaker(state.values["slip_n"], state), *state.slips]


def _weaker(limit_n: float, state: StepState) -> list[Predicate]:
    if state.holding:
        return [GripForceBelow(limit_n)]
    return [GripForceBelow(limit_n, once_above=True)] if state.closing else []


def _collision(_: Condition, state: StepState) -> list[Predicate]:
    return [BodyTouch(), *state.overloads]


def _lost(_: Condition, state: StepState) -> list[Predicate]:
    width_m = state.values.get("held_width_m", 0.0)
    return [HandWidthBelow(max(width_m - state.values["lost_m"], 0.5 * width_m))] if state.holding else []


def _jam(_: Condition, state: StepState) -> list[Predicate]:
    return [NoProgress(behind_m=state.values["jam_m"], force_n=state.values["jam_n"])]


#: event -> stop reason and constructor of its predicates (an empty list: nothing to monitor in this step)
EVENTS: dict[str, tuple[StopReason, Maker]] = {
    "CONTACT": (StopReason.CONTACT, _contact),
    "NO-CONTACT": (StopReason.NO_CONTACT, _no_contact),
    "COLLISION": (StopReason.COLLISION, _collision),
    "SLIP": (StopReason.SLIP, _slip),
    "OBJECT-LOST": (StopReason.OBJECT_LOST, _lost),
    "JOINT-LIMIT": (StopReason.JOINT_LIMIT, lambda c, state: [JointMarginBelow(state.values["joint_margin_rad"])]),
    "NO-PROGRESS": (StopReason.FORCE_LIMIT, _jam),
    "TIMEOUT": (StopReason.TIMEOUT, lambda c, state: [TimeAbove(state.values["time_limit_s"])]),
}


def _figure(condition: Condition) -> float:
    """The figure of a condition as predicates have it: turns in rad."""
    assert condition.quantity is not None
    return condition.quantity.value * (math.tau if condition.quantity.unit == "turn" else 1.0)


def _both_ways(condition: Condition, state: StepState) -> list[list[float] | None]:
    if condition.along is None:
        return [None]
    axis = axes.in_tool(state.hand_pose, condition.along)
    return [axis, [-n for n in axis]]


def _torque_axes(condition: Condition, state: StepState) -> list[list[float] | None]:
    if condition.along is None and state.spindle is not None:
        return [state.spindle, [-n for n in state.spindle]]
    return _both_ways(condition, state)


def _force(condition: Condition, state: StepState) -> list[Predicate]:
    return [ForceAbove(limit_n=_figure(condition), axis=axis) for axis in _both_ways(condition, state)]


def _torque(condition: Condition, state: StepState) -> list[Predicate]:
    return [TorqueAbove(limit_nm=_figure(condition), axis=axis) for axis in _torque_axes(condition, state)]


def _less_force(condition: Condition, state: StepState) -> list[Predicate]:
    return [ForceBelow(limit_n=_figure(condition), axis=_both_ways(condition, state)[0])]


def _less_torque(condition: Condition, state: StepState) -> list[Predicate]:
    return [TorqueBelow(limit_nm=_figure(condition), axis=_torque_axes(condition, state)[0])]


def _squeeze(condition: Condition, state: StepState) -> list[Predicate]:
    return [GripForceAbove(_figure(condition))]


def _grip(condition: Condition, state: StepState) -> list[Predicate]:
    return _weaker(_figure(condition), state)


def _near(condition: Condition, state: StepState) -> list[Predicate]:
    if state.object_at is None:
        return []
    return [TcpNear(point=state.object_at, distance_m=_figure(condition), axis=_in_world(condition, state))]


def _far(condition: Condition, state: StepState) -> list[Predicate]:
    point = state.hand_pose[:3].tolist() if state.object_at is None else state.object_at
    return [TcpFar(point=point, distance_m=_figure(condition), axis=_in_world(condition, state))]


def _close(condition: Condition, state: StepState) -> list[Predicate]:
    return [ClearanceBelow(limit_m=_figure(condition), except_near=state.beside)]


def _turn(condition: Condition, state: StepState) -> list[Predicate]:
    if condition.along is not None and condition.along.startswith(JOINT):
        number = int(condition.along.removeprefix(JOINT))
        return [JointTurnAbove(joint=number - 1, limit_rad=_figure(condition))]
    return [TurnAbove(limit_rad=_figure(condition), axis=_in_world(condition, state))]


def _in_world(condition: Condition, state: StepState) -> list[float] | None:
    if condition.along is None:
        return None
    axis: list[float] = geometry.rotate(state.hand_pose, axes.in_tool(state.hand_pose, condition.along)).tolist()
    return axis


#: (measure, bound) -> stop reason and constructor of its predicates
MEASURES: dict[tuple[str, str], tuple[StopReason, Maker]] = {
    ("FORCE", "above"): (StopReason.FORCE_LIMIT, _force),
    ("TORQUE", "above"): (StopReason.TORQUE_LIMIT, _torque),
    ("FORCE", "below"): (StopReason.FORCE_LIMIT, _less_force),
    ("TORQUE", "below"): (StopReason.TORQUE_LIMIT, _less_torque),
    ("GRIP-FORCE", "below"): (StopReason.SLIP, _grip),
    ("GRIP-FORCE", "above"): (StopReason.FORCE_LIMIT, _squeeze),
    ("DISTANCE", "below"): (StopReason.CONTACT, _near),
    ("DISTANCE", "above"): (StopReason.OUT_OF_RANGE, _far),
    ("CLEARANCE", "below"): (StopReason.OUT_OF_RANGE, _close),
    ("TURN", "above"): (StopReason.OUT_OF_RANGE, _turn),
}


def reason_of(condition: Condition) -> StopReason | None:
    """The stop reason of this condition; None if the motion loop cannot measure it."""
    row = _row(condition)
    return None if row is None else row[0]


def refuse_unsupported(reflex: ReflexItem, about_object: bool, joints: int) -> None:
    """Refuse a reflex that cannot be performed. `about_object`: the command names an object. `joints`: number of
    joints of an arm."""
    refuse_condition(reflex.condition, about_object, joints)
    if reflex.action not in ACTIONS:
        word = reflex.action.upper().replace("_", "-")
        raise _refused(f"THEN {word} is not supported", [action.upper().replace("_", "-") for action in ACTIONS])


def refuse_condition(condition: Condition, about_object: bool, joints: int, word: str = "UNLESS") -> None:
    """Refuse a condition that the motion loop does not measure. `word`: that introduces it."""
    words = f"{word} {condition.words}"
    if _row(condition) is None:
        known = [*EVENTS, *(f"{measure} {bound}" for measure, bound in MEASURES)]
        raise _refused(f"{words}: nothing in the motion loop measures that", known, where=words)
    if condition.measure == "GRIP-FORCE" and condition.along is not None:
        raise _refused(f"{words}: the fingers press along one axis only", [], "leave out ALONG and its axis", words)
    if condition.measure == "TURN" and (condition.along or "").startswith(JOINT):
        number = (condition.along or "").removeprefix(JOINT)
        if not number.isdigit() or not 1 <= int(number) <= joints:
            raise suggestions.unknown("joint", condition.along or "", [f"{JOINT}{n + 1}" for n in range(joints)])
        return
    if condition.measure == "CLEARANCE" and condition.along is not None:
        raise _refused(f"{words}: a clearance is measured in all directions", [], "leave out ALONG and its axis", words)
    if condition.measure == "TURN" and condition.along is None and _figure(condition) > math.pi:
        message = f"{words}: without an axis the change of attitude is measured, which is 180 DEG at most"
        raise _refused(message, [], "an axis, as in UNTIL TURN ALONG TOOL-Z EXCEEDS 2 TURNS", words)
    if condition.measure == "DISTANCE" and condition.bound == "below" and not about_object:
        message = f"{words} measures the distance to the object of the command, but this command names none"
        raise _refused(message, [], "leave it out, or use a verb that takes an object", words)
    if condition.along is not None and condition.along not in AXES:
        raise suggestions.unknown("axis", condition.along, AXES, where=words)


def refuse_without_grip(condition: Condition, arm: str, holding: bool, closes: bool) -> None:
    """Refuse a condition about a held object for a hand that holds none, so that it can never become true. `closes`: a
    step of the script closes the hand."""
    about = condition.event in HELD or (condition.measure, condition.bound) == ("GRIP-FORCE", "below")
    if not about or holding or (closes and condition.event != "OBJECT-LOST"):
        return
    message = f"{condition.words} is about a held object, but {arm} holds none"
    raise _refused(message, [], f"leave out {condition.words}, or GRASP an object first", condition.words)


def report_conditions(conditions: list[Condition], state: StepState) -> list[ReportCondition]:
    """Build the conditions of REPORT WHEN for one step, numbered as in the sentence."""
    made = []
    for n, condition in enumerate(conditions):
        row = _row(condition)
        assert row is not None, condition
        made += [ReportCondition(n=n, when=when) for when in row[1](condition, state)]
    return made


def stop_functions(reflexes: list[ReflexItem], state: StepState) -> list[StopFunction]:
    """Build the stop functions of these reflexes for one step."""
    made = []
    for reflex in reflexes:
        row = _row(reflex.condition)
        assert row is not None, reflex
        reason, maker = row
        action = ACTIONS[reflex.action]
        by = reflex.by.value if reflex.by else state.values["back_off_m"]
        back_off_m = by if action is Reflex.BACK_OFF else 0.0
        made += [
            StopFunction(reason=reason, when=_in_reach(when, action, state), reflex=action, back_off_m=back_off_m)
            for when in maker(reflex.condition, state)
        ]
    return made


def until_functions(until: Condition, state: StepState) -> list[StopFunction]:
    """Build the stop functions of UNTIL for one step. Raises Refused if nothing in the step measures it, or if the
    step is stopped before it comes true."""
    row = _row(until)
    assert row is not None, until
    reason, maker = row
    made = maker(until, state)
    if not made:
        raise _refused(f"UNTIL {until.words}: nothing in this motion measures that", [], "another condition", "UNTIL")
    for when in made:
        _refuse_out_of_reach(until, when, state)
    return [StopFunction(reason=reason, when=when) for when in made]


def _refuse_out_of_reach(until: Condition, when: Predicate, state: StepState) -> None:
    """Refuse an UNTIL whose force or torque is above the limit that stops the step."""
    cause: causes.Cause
    for limit in state.overloads:
        match when, limit:
            case (ForceAbove(limit_n=asked), ForceAbove(limit_n=most)) if asked >= most:
                unit, cause = "N", causes.UntilForce(value_n=asked, limit_n=most)
            case (TorqueAbove(limit_nm=asked), TorqueAbove(limit_nm=most)) if asked >= most:
                unit, cause = "N.m", causes.UntilTorque(value_nm=asked, limit_nm=most)
            case _:
                continue
        raise Refused.because(
            RefusalReason.INFEASIBLE,
            f"UNTIL {until.sentence}: this motion is stopped at {in_words(most, unit)}",
            where="UNTIL",
            clears=f"a value below {in_words(most, unit)}: UNTIL {until.words} {in_words(SHARE * most, unit).upper()}",
            cause=cause,
        )


def _in_reach(when: Predicate, action: Reflex, state: StepState) -> Predicate:
    """The condition of a reflex that takes the force away, no higher than the step's own limit, which stops the arm."""
    if action not in EASING:
        return when
    match when:
        case ForceAbove():
            limits_n = [limit.limit_n for limit in state.overloads if isinstance(limit, ForceAbove)]
            return msgspec.structs.replace(when, limit_n=min(when.limit_n, *limits_n)) if limits_n else when
        case TorqueAbove():
            limits_nm = [limit.limit_nm for limit in state.overloads if isinstance(limit, TorqueAbove)]
            return msgspec.structs.replace(when, limit_nm=min(when.limit_nm, *limits_nm)) if limits_nm else when
    return when


def _row(condition: Condition) -> tuple[StopReason, Maker] | None:
    if condition.event is not None:
        return EVENTS.get(condition.event)
    return MEASURES.get((condition.measure or "", condition.bound or ""))


def _refused(
    message: str, expected: list[str], clears: str = "leave it out, or use one of those expected", where: str = "UNLESS"
) -> Refused:
    reason = RefusalReason.NO_SCRIPT
    return Refused.because(reason, message, where=where, expected=expected, clears=clears)


# --- evaluation of a report ------------------------------------------------------------------------------


def find_requested(reflexes: list[ReflexItem], report: EndReport) -> ReflexItem | None:
    """The reflex of the command that ended the primitive (same reason, figure and action); None if there is none."""
    for reflex in reflexes:
        if has_ended(reflex.condition, report) and ACTIONS.get(reflex.action) is report.reflex:
            return reflex
    return None


def has_ended(condition: Condition, report: EndReport) -> bool:
    """Whether this condition has ended the primitive: the same reason and figure."""
    given = condition.quantity is not None
    same = not given or (report.limit is not None and math.isclose(_figure(condition), report.limit))
    return same and reason_of(condition) is report.reason


def reflex_in_words(reflex: ReflexItem) -> str:
    """The reflex in the words of a sentence."""
    return f"UNLESS {reflex.condition.sentence} THEN {reflex.action.upper().replace('_', '-')}"


def describe_action(report: EndReport) -> str:
    """The reflex action after the stop, in words; empty if the arm only stopped."""
    if report.reflex is Reflex.BACK_OFF and report.trip_pose and report.tcp_pose:
        turned_deg = math.degrees(geometry.angle(report.trip_pose, report.tcp_pose))
        turned = f" and {turned_deg:.1f} deg" if turned_deg > TURNED_DEG else ""
        return f"backed off by {100.0 * geometry.distance(report.trip_pose, report.tcp_pose):.1f} cm{turned}"
    if report.reflex is Reflex.COMPLY and report.trip_pose and report.tcp_pose:
        return f"gave way by {1000.0 * geometry.distance(report.trip_pose, report.tcp_pose):.1f} mm"
    return f"opened the hand to {1000.0 * report.hand_width_m:.0f} mm" if report.reflex is Reflex.RELEASE else ""
