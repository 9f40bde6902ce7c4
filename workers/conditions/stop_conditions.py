"""Stop conditions (F): the figures in force for a step and the stop functions built from them (R66, R82, R83). Pure.

Figures come from the cell, the program, the stop class and the step, in order of increasing priority. GUARDED and
MAINTAIN can only tighten them. Rows of the program name predicates of the primitive by their tags.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import msgspec

from rtc.model.cells import parts
from rtc.programs import expressions
from rtc.programs.schema import BinderProgram, StopClass, StopRow
from rtc.protocol.messages import BinderInput, OperateStep, TurnStep
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import (
    BodyTouch,
    ClearanceBelow,
    FollowingErrorAbove,
    ForceAbove,
    GoalReached,
    GripForceAbove,
    GripForceBelow,
    HandWidthBelow,
    JointMarginBelow,
    NoProgress,
    Predicate,
    Reporting,
    SpeedAbove,
    StopFunction,
    TcpInside,
    TcpOutside,
    TcpSpeedAbove,
    TcpTurned,
    TimeAbove,
    TorqueAbove,
    TorqueBelow,
    TurnAbove,
    UnseenAbove,
    Vector,
)
from workers.conditions import reflexes
from workers.planning.motion.constraints import ATTITUDE_RAD, attitude_tolerance_rad
from workers.planning.world_query import WorldQuery

Values = dict[str, float]


class TurnLine(NamedTuple):
    """The line about which a step turns (world): that of a circle, or the axis of the step through the hand."""

    axis: Vector | None  # unit vector; None: any change of attitude
    point: Vector | None  # None: the hand


#: tag of a predicate -> constructor from the limit, the axis of an opposing force (tool frame), the line and figures
MAKERS: dict[str, Callable[[float, Vector | None, TurnLine, Values], Predicate]] = {
    "goal-reached": lambda limit, axis, line, values: GoalReached(_stretched_m(values)),
    "time-above": lambda limit, axis, line, values: TimeAbove(limit),
    "force-above": lambda limit, axis, line, values: ForceAbove(limit_n=limit, axis=axis),
    "torque-above": lambda limit, axis, line, values: TorqueAbove(limit_nm=limit, axis=axis),
    "torque-below": lambda limit, axis, line, values: TorqueBelow(limit_nm=limit, axis=axis),
    "speed-above": lambda limit, axis, line, values: SpeedAbove(limit),
    "following-error-above": lambda limit, axis, line, values: FollowingErrorAbove(limit),
    "joint-margin-below": lambda limit, axis, line, values: JointMarginBelow(limit),
    "body-touch": lambda limit, axis, line, values: BodyTouch(),
    "grip-force-below": lambda limit, axis, line, values: GripForceBelow(limit),
    "hand-width-below": lambda limit, axis, line, values: HandWidthBelow(limit),
    "no-progress": lambda limit, axis, line, values: NoProgress(behind_m=limit, force_n=values["jam_n"]),
    "turn-above": lambda limit, axis, line, values: TurnAbove(limit_rad=limit, axis=line.axis, point=line.point),
    "unseen-above": lambda limit, axis, line, values: UnseenAbove(limit),
}


def _stretched_m(values: Values) -> float | None:
    """How far from its goal a compliant arm may rest, if the step states it; the analyzer judges by the same figure."""
    return values.get("within_m") if "stiffness_n_m" in values else None


#: limit of MAINTAIN -> the figure that it tightens
TIGHTENED = {"speed_m_s": "speed_m_s", "force_n": "force_n", "torque_nm": "torque_nm"}
OVERLOADS = {"force-above": StopReason.FORCE_LIMIT, "torque-above": StopReason.TORQUE_LIMIT}
NEAR_M = 0.05  # added to the radius of what a command may come near to: how far it may be from where it is believed


def figures_in_force(
    program: BinderProgram, stop_class: StopClass, query: WorldQuery, data: BinderInput, arm: str
) -> Values:
    """All figures in force for this step of `arm`, which need not be that of the command. Raises ExpressionError if an
    expression names an unknown figure."""
    context = data.context
    values: Values = dict(msgspec.structs.asdict(query.cell.numbers))
    if query.holding(arm):
        values["held_width_m"] = query.hand_width(arm)
    for rows in (program.values, stop_class.values):
        for name, expression in rows.items():
            values[name] = expressions.number(expression, values)
    values |= data.step.overrides | data.step.given()
    if context.guarded:
        for name, value in program.guarded.get(context.verb, program.guarded.get("", {})).items():
            values[name] = min(value, values.get(name, value))
    for limit, name in TIGHTENED.items():
        value = getattr(context.limits, limit)
        if value is not None:
            values[name] = min(value, values.get(name, value))
    if context.limits.stiffness_n_m is not None:
        values["stiffness_n_m"] = context.limits.stiffness_n_m
    if context.limits.speed_ratio is not None and "speed_m_s" in values:
        values["speed_m_s"] *= context.limits.speed_ratio
    return values


def stop_functions(
    rows: list[StopRow], values: Values, against: Vector | None, requested: list[StopFunction], line: TurnLine
) -> list[StopFunction]:
    """Build F: the stop functions of the command, then those of the program's rows.

    Of two with the same reason the first true one wins. A reflex of the command therefore precedes the program's stop
    at the same figure, and neither loosens the other. `against`: unit vector (tool frame) of an opposing force. `line`:
    about which the step turns.
    """
    made = list(requested)
    for row in rows:
        when = MAKERS[row.when](_limit(row, values), against if row.against_motion else None, line, values)
        made.append(StopFunction(reason=row.reason, when=when, reflex=row.reflex, back_off_m=row.back_off_m))
    return made


def _limit(row: StopRow, values: Values) -> float:
    """The limit of a row; 0 if its predicate has none."""
    return 0.0 if row.limit is None else expressions.number(row.limit, values)


def maintained(data: BinderInput, query: WorldQuery, values: Values) -> list[StopFunction]:
    """Stop functions of MAINTAIN for a motion of the arm. The plan keeps the same limits, without their tolerances."""
    limits, cell = data.context.limits, query.cell
    made: list[tuple[StopReason, Predicate]] = []
    margin_m, load = values["range_margin_m"], query.load_boxes(data.step.arm or data.context.arm)
    if limits.work_range:
        region = cell.region(limits.work_range)
        size_m = [side + 2.0 * margin_m for side in region.size_m]
        made.append((StopReason.OUT_OF_RANGE, TcpOutside(centre=region.frame.pose.tolist(), size_m=size_m, load=load)))
    for name in limits.keep_out:
        region = cell.region(name)
        size_m = [max(side - 2.0 * margin_m, 0.5 * side) for side in region.size_m]  # a thin region is watched too
        made.append((StopReason.OUT_OF_RANGE, TcpInside(centre=region.frame.pose.tolist(), size_m=size_m, load=load)))
    if limits.attitude and data.step.arm in ("", data.context.arm):  # only the first hand keeps it
        frame = cell.attitudes[limits.attitude]
        more_rad = attitude_tolerance_rad(query.tcp(data.context.arm), frame) - ATTITUDE_RAD
        turned = TcpTurned(attitude=frame.pose[3:].tolist(), limit_rad=values["turned_rad"] + more_rad)
        made.append((StopReason.OUT_OF_RANGE, turned))
    if limits.clearance_m:
        least_m = max(limits.clearance_m - margin_m, 0.5 * limits.clearance_m)
        made.append((StopReason.OUT_OF_RANGE, ClearanceBelow(limit_m=least_m, except_near=_beside(data, query))))
    if limits.speed_m_s is not None or limits.speed_ratio is not None:
        most_m_s = values["fast_factor"] * values["speed_m_s"] + values["fast_m_s"]
        made.append((StopReason.OVERSPEED, TcpSpeedAbove(most_m_s)))
    return [StopFunction(reason=reason, when=when) for reason, when in made]


def near(data: BinderInput, query: WorldQuery, limit_m: float) -> list[StopFunction]:
    """The stop function of an arm that no plan keeps away from others: it may come near only to what it is about."""
    when = ClearanceBelow(limit_m=limit_m, except_near=_beside(data, query))
    return [StopFunction(reason=StopReason.OUT_OF_RANGE, when=when)]


def squeezed(data: BinderInput, values: Values) -> list[StopFunction]:
    """Stop functions of MAINTAIN GRIP-FORCE for a hand that holds something."""
    most_n = squeeze_limit_n(data, values)
    return [StopFunction(reason=StopReason.FORCE_LIMIT, when=GripForceAbove(most_n))] if most_n else []


def squeeze_limit_n(data: BinderInput, values: Values) -> float:
    """The finger force (N) that MAINTAIN GRIP-FORCE allows; 0: the sentence states none."""
    grip_n = data.context.limits.grip_force_n
    return 0.0 if grip_n is None else values["squeeze_factor"] * grip_n + values["squeeze_n"]


def from_command(
    data: BinderInput,
    query: WorldQuery,
    values: Values,
    rows: list[StopRow],
    arm: str = "",
    against: Vector | None = None,
) -> list[StopFunction]:
    """Stop functions of the command's UNTIL and UNLESS ... THEN ... for this step, whose own rows are `rows`. `arm`: a
    second arm that takes part in it. `against`: as in `stop_functions`. Raises Refused for an impossible UNTIL."""
    context = data.context
    ends = context.until if data.step.until else None
    if ends is None and not context.reflexes:
        return []
    state = _state(data, query, values, rows, arm, against)
    until = [] if ends is None else reflexes.until_functions(ends, state)
    return [*until, *reflexes.stop_functions(context.reflexes, state)]


def reporting(data: BinderInput, query: WorldQuery, values: Values, rows: list[StopRow]) -> Reporting:
    """R: the command's REPORT for this step."""
    asked = data.context.report
    if asked is None:
        return Reporting()
    when = reflexes.report_conditions(asked.when, _state(data, query, values, rows)) if asked.when else []
    return Reporting(items=asked.items, every_s=asked.every_s, when=when)


def _state(
    data: BinderInput,
    query: WorldQuery,
    values: Values,
    rows: list[StopRow],
    arm: str = "",
    against: Vector | None = None,
) -> reflexes.StepState:
    context, arm = data.context, arm or data.step.arm or data.context.arm
    return reflexes.StepState(
        values=values,
        hand_pose=query.tcp(arm),
        holding=bool(query.holding(arm)),
        object_at=query.frame(context.object)[:3].tolist() if context.object else None,
        closing=data.step.op == "close",
        beside=_beside(data, query),
        overloads=_overloads(rows, values),
        slips=_slips(rows, values, against),
        spindle=against if isinstance(data.step, TurnStep) else None,
    )


def _slips(rows: list[StopRow], values: Values, against: Vector | None) -> list[Predicate]:
    """The predicates of the rows that end the step because what it turns has come off."""
    slips = [row for row in rows if row.reason is StopReason.SLIP and row.when in ("torque-below",)]
    return [stop.when for stop in stop_functions(slips, values, against, [], TurnLine(None, None))]


def _overloads(rows: list[StopRow], values: Values) -> list[reflexes.Overload]:
    """The force and torque limits among the rows: those of the program, not the force of an expected touch."""
    made = []
    for row in rows:
        if OVERLOADS.get(row.when) is row.reason:
            made.append(MAKERS[row.when](_limit(row, values), None, TurnLine(None, None), values))
    return [when for when in made if isinstance(when, reflexes.Overload)]


def _beside(data: BinderInput, query: WorldQuery) -> list[Vector]:
    """Balls round the object and the target of the command, and round their seats: a command may come near to them.

    There is none round what the hand holds, which is watched itself. It may come near to its seat; not by hand, because
    a hand needs no way through it, and may leave what is near at the start."""
    context, cell = data.context, query.cell
    things = {thing.name: thing.shapes for thing in cell.objects}
    seats = {seat.name: seat.shapes for seat in cell.seats}
    meant, held = [context.object, context.target], query.holding(data.step.arm or context.arm)
    by_hand = isinstance(data.step, OperateStep)
    meant += [query.seat(name) for name in (*meant, *([] if by_hand else [held])) if name in things]
    balls = []
    for name in dict.fromkeys(name for name in meant if name != held):
        if shapes := things.get(name) or seats.get(name):
            frame = query.seat_frame(name) if name in seats else query.frame(name)
            reach_m = max(math.hypot(*shape.frame.xyz) + parts.radius_m(shape) for shape in shapes)
            balls.append([*frame[:3].tolist(), reach_m + NEAR_M])
    return balls
