"""Binder worker function: (program, one step, world) -> a primitive with its expected result, or a refusal.

Called once per step, nominal or corrective (R135), with the current bindings. Fixed parameters are used unchanged;
parameters measured in an earlier step are used in the same way (R136). A step without motion yields bindings instead.
The program defines the meaning of a script's words; this module knows no skill.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import msgspec

from rtc.language.hands import hand_in_words
from rtc.programs import expressions
from rtc.programs.loader import decode
from rtc.programs.schema import BinderProgram, StopClass
from rtc.protocol.messages import BinderInput, Binding, BoundStep, EndReport, EvaluationContext, Limits, Validity
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused, StopReason, refuse_if
from rtc.protocol.primitive import (
    HandMotion,
    HoldStill,
    JointTrajectory,
    Load,
    Primitive,
    Reporting,
    StopFunction,
    Trajectory,
    Vector,
)
from rtc.protocol.primitive_id import command_of, seed_of
from rtc.protocol.units import in_words
from rtc.world.model import World
from workers.binder import compliance, impact, look, replan, targets, together
from workers.binder.bind_task import BindTask, refuse_if_endless, refused_program
from workers.conditions import looking, sharing, stop_conditions
from workers.conditions.stop_conditions import Values
from workers.planning import advice, certainty, in_seat, segments, suggestions
from workers.planning.motion import beside
from workers.planning.motion import plan as plans
from workers.planning.motion.plan import Motion
from workers.planning.motion.request import PlanningRequest
from workers.planning.motion.timing import SpeedLimits
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery

INPUT = BinderInput
NEEDS_WORLD = True
NEEDS_CELL = True

SUBSYSTEM = "MCM"
PERFORMERS = ("active_arm", looking.CAMERA)
STATED_BY = "OPERATOR"  # performer in the report of facts that a command states
MIN_WIDTH_M = 1e-6  # rounding tolerance of the hand's range
DETOUR = 3.0  # a relative step in joint space is reported if the hand travels this many times its distance
DETOUR_KNOTS = 20  # at which the way of the hand is measured


def compile(program: bytes) -> BinderProgram:
    """Check the program. Raises ProgramError."""
    return decode(program, BinderProgram)


def run(compiled: BinderProgram, cell: CellModel | None, world: World | None, data: BinderInput) -> BoundStep | Refusal:
    """Bind the step to the current world."""
    assert cell is not None
    assert world is not None
    query = WorldQuery(cell, world, data.at_s, seed_of(command_of(data.primitive_id)), data.moving)
    try:
        return _bound(BindTask(compiled, query, data))
    except Refused as refused:
        return refused.refusal
    except expressions.ExpressionError as error:
        lacking = "a figure that the step needs must be in the script, the program or the cell"
        return refused_program(str(error), lacking).refusal


def _bound(task: BindTask) -> BoundStep:
    step, known = task.data.step, task.program.actions
    if step.who not in PERFORMERS:
        raise refused_program(f"a step for {step.who}", f"performers of steps are {', '.join(PERFORMERS)}")
    if step.do not in known:
        raise refused_program(f"unknown action {step.do}", f"there are {', '.join(known)}")
    return ACTIONS[known[step.do]](task)


# --- a motion of the arm ---------------------------------------------------------------------------------


def bind_motion(task: BindTask) -> BoundStep:
    step, context, query, clears = task.data.step, task.data.context, task.query, task.program.clears
    stop_class = task.stop_class(step.stop)
    if step.space not in segments.SPACES:
        raise refused_program(f"no space {step.space}", f"there are {', '.join(segments.SPACES)}")
    refuse_if(certainty.why_uncertain(query, task.arm, step.args, clears))
    sharing.refuse_alone(query, task.arm, context.partner, clears)
    target = targets.target_of(task)
    in_seat.refuse_other_way(query, task.arm, step.space, query.tcp(task.arm), target.pose, clears)
    values = stop_conditions.figures_in_force(task.program, stop_class, query, task.data, task.arm)
    held = query.holding(task.arm)
    expected = step.space != "move_joint" or stop_class.touches
    keep = impact.keeping(task, target, values, held, touches=expected)
    request = planning_request(task, stop_class, values, held, keep.speed_m_s)
    try:
        motion = segments.plan_segment(request, step.space, target, step.way)
    except Refused as refused:
        leaves_seat = step.args.get("leaves") == "seat"
        blocked = refused.refusal
        raise Refused(
            advice.advise_on_collision(blocked, query, task.arm, clears, context.limits, leaves_seat=leaves_seat)
        ) from None
    motion = impact.kept(task, motion, values, keep)
    if "takes_s" in step.args:
        motion = plans.slowed_to(motion, float(step.args["takes_s"]))
    remarks = [*filter(None, (keep.remark, speed_not_kept(context.limits, values), detour(task, motion)))]
    evaluation = EvaluationContext(
        context=context,
        step=msgspec.structs.replace(step, way=None),
        arm=task.arm,
        goal_pose=motion.goal_pose.tolist(),
        remark="; ".join(remarks),
        held=held,
        predicted_s=motion.timed.duration_s,
        no_contact_is_failure=StopReason.CONTACT in step.expect and StopReason.GOAL not in step.expect,
        start_joints=request.start.tolist(),
    )
    against = targets.against_motion(query.tcp(task.arm).tolist(), motion) if step.space == "move_task" else None
    trajectory = motion.timed.trajectory()
    note = "; ".join((*remarks, *motion.notes))
    bound = primitive(task, stop_class, values, trajectory, evaluation, against, note)
    if remarks:
        bound = msgspec.structs.replace(bound, remark="; ".join(remark.partition(": ")[0] for remark in remarks))
    if motion.partner is not None:
        line = targets.turn_line(task)
        kept = stop_conditions.maintained(task.data, query, values)
        both = (bound, motion.partner, stop_class, values, line, kept)
        bound = together.with_partner(task.program, query, task.data, *both)
    return beside_others(task, request, bound)


def speed_not_kept(limits: Limits, values: Values) -> str:
    """The remark that the SPEED of the sentence is looser than that of the step, which is not changed; else empty."""
    if limits.speed_m_s is None or limits.speed_m_s <= values["speed_m_s"]:
        return ""
    asked, own = in_words(limits.speed_m_s, "m/s"), in_words(values["speed_m_s"], "m/s")
    return f"SPEED {asked} changes nothing: this step moves at {own} at most"


def detour(task: BindTask, motion: Motion) -> str:
    """The remark that a relative step takes the hand a much longer way through joint space; else empty."""
    step = task.data.step
    if step.space != "move_joint" or "by_m" not in step.args:
        return ""
    knots = motion.timed.positions[:: max(1, len(motion.timed.positions) // DETOUR_KNOTS)]
    places = [task.query.model.arms[task.arm].fk(joints)[:3] for joints in (*knots, motion.goal_joints)]
    way_m = sum(math.dist(here, there) for here, there in itertools.pairwise(places))
    step_m = math.dist(places[0], places[-1])
    if way_m <= DETOUR * step_m:
        return ""
    return f"the hand travels {way_m:.2f} m to be {in_words(round(step_m, 3), 'm')} away"


def planning_request(
    task: BindTask, stop_class: StopClass, values: Values, held: str, speed_m_s: float
) -> PlanningRequest:
    """The planning problem of this motion, except its target. `held`: the object in the hand; empty: none."""
    query, context = task.query, task.data.context
    touches = stop_class.touches or bool(context.object or context.target)
    scene = query.scene(
        task.arm,
        context.limits,
        touching=context.object if stop_class.touches and held != context.object else "",
        seated=stop_class.seated,
        ignore_suspect=stop_class.away,
        exempt=[name for name in (context.object, context.target) if name],
        unsure=task.data.step.space not in segments.STRAIGHT or not touches,
    )
    pace = SpeedLimits(speed_m_s, values["laden_acceleration_m_s2" if held else "acceleration_m_s2"])
    margin_rad = math.radians(values["joint_margin_deg"])
    request = query.planning_request(task.arm, scene, context.limits, pace, margin_rad)
    return replace(request, partner=query.model.arms[context.partner]) if context.partner else request


def beside_others(task: BindTask, request: PlanningRequest, bound: BoundStep) -> BoundStep:
    """The step with the conditions of its start beside the motions of other arms."""
    if not task.query.moving or bound.primitive is None:
        return bound
    conditions = beside.start_conditions(request, bound.primitive, task.query.moving)
    if not conditions:
        return bound
    awaited = ", ".join(command_of(condition.primitive) for condition in conditions)
    return msgspec.structs.replace(
        bound,
        primitive=msgspec.structs.replace(bound.primitive, start_after=conditions),
        limit_s=bound.limit_s + max(condition.within_s for condition in conditions),
        note=f"{bound.note}; starts when {awaited} has left the space that it needs",
    )


# --- a motion of the hand --------------------------------------------------------------------------------


def bind_hand(task: BindTask) -> BoundStep:
    return hand_motion(task, task.data.step.op)


def hand_motion(task: BindTask, op: str) -> BoundStep:
    """Open the hand to a width, or close it until it grips an object or is fully closed."""
    step, context, query = task.data.step, task.data.context, task.query
    if op not in task.program.hand:
        raise refused_program(f"a hand cannot {op}", f"it can {', '.join(task.program.hand)}")
    stop_class = task.stop_class(task.program.hand[op])
    values = stop_conditions.figures_in_force(task.program, stop_class, query, task.data, task.arm)
    gripper = query.cell.arm(task.arm).gripper
    width_m = values.get("width_m", 0.0)
    grip_n = context.limits.grip_force_n or values.get("grip_n", values["hand_n"])
    for name, value, most, unit in (
        ("opening", width_m, gripper.max_opening_m, "m"),
        ("grip force", grip_n, gripper.max_force_n, "N"),
    ):
        if not -MIN_WIDTH_M <= value <= most + MIN_WIDTH_M:
            raise _refused_hand_figure(task, name, value, most, unit)
    way_m = abs(query.hand_width(task.arm) - width_m)
    evaluation = EvaluationContext(
        context=context,
        step=step,
        arm=task.arm,
        goal_pose=query.tcp(task.arm).tolist(),
        held=query.holding(task.arm),
        predicted_s=way_m / gripper.speed_m_s,
        width_m=[values.get("least_m", 0.0), values.get("most_m", gripper.max_opening_m + 0.001)],
        start_joints=list(query.joints(task.arm)),
    )
    motion = HandMotion(width_m=width_m, force_n=grip_n, speed_m_s=gripper.speed_m_s)
    return primitive(task, stop_class, values, motion, evaluation, None, "", moves=False)


def _refused_hand_figure(task: BindTask, name: str, value: float, most: float, unit: str) -> Refused:
    hand = task.query.cell.arm(task.arm).end_effector
    now = f"; it is open {in_words(task.query.hand_width(task.arm), 'm')} now" if unit == "m" else ""
    refusal = Refusal(
        reason=RefusalReason.INFEASIBLE,
        message=f"{name} of {hand}: {in_words(value, unit)} is asked for; it can have 0 to {in_words(most, unit)}{now}",
        clears=f"{name} of 0 to {in_words(most, unit)}",
        detail={"cause": name, f"value_{unit.lower()}": value, f"limit_{unit.lower()}": most, "arm": task.arm},
    )
    return Refused(refusal)


# --- staying ---------------------------------------------------------------------------------------------


def bind_still(task: BindTask) -> BoundStep:
    step, query = task.data.step, task.query
    stop_class = task.stop_class(step.stop)
    values = stop_conditions.figures_in_force(task.program, stop_class, query, task.data, task.arm)
    duration_s = values["duration_s"]
    left_s = time_left_s(task)
    if left_s is not None:
        if left_s <= 0.0:
            raise _refused_time(task, 0.0, left_s)
        duration_s = min(duration_s, left_s)
    known = query.trusts(f"{task.arm}.joints")  # otherwise only the report will contain the position that the arm holds
    evaluation = EvaluationContext(
        context=task.data.context,
        step=step,
        arm=task.arm,
        goal_pose=query.tcp(task.arm).tolist() if known and "press_n" not in values else None,
        held=query.holding(task.arm),
        predicted_s=duration_s,
        start_joints=list(query.joints(task.arm)),
    )
    return primitive(task, stop_class, values, HoldStill(duration_s=duration_s), evaluation, None, "", timed=False)


# --- a camera --------------------------------------------------------------------------------------------


def bind_look(task: BindTask) -> BoundStep:
    stop_class = task.stop_class(task.data.step.stop)
    values = stop_conditions.figures_in_force(task.program, stop_class, task.query, task.data, task.arm)
    return look.bind(task.query, task.data, stop_class, values)


# --- the primitive ---------------------------------------------------------------------------------------


def primitive(
    task: BindTask,
    stop_class: StopClass,
    values: Values,
    trajectory: Trajectory,
    evaluation: EvaluationContext,
    against: Vector | None,
    note: str,
    *,
    moves: bool = True,
    timed: bool = True,
) -> BoundStep:
    """Assemble T = (P, M, F, R).

    `moves`: the arm moves, so a held object is monitored, if it is known how it is held. `timed`: the time limit of the
    command applies.
    """
    limit_s = values["time_factor"] * evaluation.predicted_s + values["time_margin_s"]
    left_s = time_left_s(task)
    if left_s is not None and timed:
        if evaluation.predicted_s > left_s:
            raise _refused_time(task, evaluation.predicted_s, left_s)
        limit_s = min(limit_s, left_s)
    refuse_if_endless(limit_s)
    values = {**values, "time_limit_s": limit_s}
    # An arm that may have lost what it held backs off nevertheless.
    own, grasp = command_of(task.data.primitive_id), f"{evaluation.held}.grasp"
    keeps = moves and evaluation.held and task.query.distrusted(grasp, {}, own) is None
    rows = [*stop_class.stops, *(task.program.holding if keeps else [])]
    stops: list[StopFunction] = stop_conditions.stop_functions(
        rows,
        values,
        against,
        stop_conditions.from_command(task.data, task.query, values, rows),
        targets.turn_line(task),
    )
    if isinstance(trajectory, JointTrajectory):
        stops += stop_conditions.maintained(task.data, task.query, values)
    if evaluation.held:  # a hand that closes on something off its middle presses more with one finger
        stops += stop_conditions.squeezed(task.data, values)
    every_s = task.data.step.args.get("report_every_s")
    lets_go = isinstance(trajectory, HandMotion) and trajectory.width_m > task.query.hand_width(task.arm)
    load = None if lets_go else task.query.load(task.arm)
    control_law = compliance.control_law(task, stop_class, values, trajectory, load)
    _refuse_weight(task, evaluation.held, load)
    made = Primitive(
        id=task.data.primitive_id,
        performer=task.arm,
        trajectory=trajectory,
        stop_functions=stops,
        control_law=control_law,
        reporting=Reporting(
            every_s=float(every_s) if every_s is not None else None,
            when=stop_conditions.reported(task.data, task.query, values, rows),
        ),
    )
    return BoundStep(
        subsystem=SUBSYSTEM,
        primitive=made,
        evaluation=evaluation,
        predicted_s=evaluation.predicted_s,
        limit_s=values["report_factor"] * limit_s + values["report_margin_s"],
        note=note,
    )


def _refuse_weight(task: BindTask, held: str, load: Load | None) -> None:
    payload_kg = task.query.cell.arm(task.arm).payload_kg
    if load is None or load.mass_kg <= payload_kg:
        return
    refusal = Refusal(
        reason=RefusalReason.INFEASIBLE,
        message=f"{held} weighs {load.mass_kg:g} kg; {task.arm} carries {payload_kg:g} kg at most",
        clears=f"let go of {held}; if it is lighter, correct its mass",
        detail={"cause": "payload", "mass_kg": load.mass_kg, "limit_kg": payload_kg, "arm": task.arm},
    )
    raise Refused(refusal)


def time_left_s(task: BindTask) -> float | None:
    """The time that the motions of the command have left of its TIME-LIMIT; None without one."""
    most_s = task.data.context.limits.time_s
    return None if most_s is None else most_s - task.data.moved_s


def _refused_time(task: BindTask, predicted_s: float, left_s: float) -> Refused:
    most_s, moved_s = task.data.context.limits.time_s or 0.0, task.data.moved_s
    left = f", of which {max(left_s, 0.0):.3g} s are left" if moved_s else ""
    refusal = Refusal(
        reason=RefusalReason.INFEASIBLE,
        message=f"this step takes {predicted_s:.3g} s; the time limit is {most_s:g} s{left}",
        clears="more time, or more speed",
        detail={"cause": "time", "predicted_s": predicted_s, "limit_s": most_s, "moved_s": moved_s},
    )
    return Refused(refusal)


# --- steps that move nothing -----------------------------------------------------------------------------


def bind_assignment(task: BindTask) -> BoundStep:
    """A binding computed from other bindings, measured or planned: GP = 0.5*(GP1 + GP2)."""
    step = task.data.step
    given: dict[str, float | list[float]] = {}
    for name in expressions.names(step.value):
        binding = targets.binding(task, name)
        given[name] = binding.number if binding.number is not None else targets.world_pose(task, binding, name)
    try:
        value = expressions.evaluate(step.value, given)
    except expressions.ExpressionError as error:
        message = f"{step.name} = {step.value}: {error}"
        apart = Refusal(reason=RefusalReason.INFEASIBLE, message=message, where=step.name, clears="measure again")
        raise Refused(apart) from error
    binding = Binding(pose=value) if isinstance(value, list) else Binding(number=value)
    return BoundStep(bindings={step.name: binding}, note=f"{step.name} = {step.value}")


def _now(task: BindTask, stated: Any) -> Any:
    """A stated value; {"now": KEY} stands for the value of that fact now. Raises Refused if it is not valid."""
    if not isinstance(stated, dict):
        return stated
    fact = task.query.world.get(stated["now"])
    if fact is not None and fact.validity is Validity.VALID:
        return fact.value
    arm = stated["now"].partition(".")[0]
    unsure = Refusal(
        reason=RefusalReason.SUSPECT,
        message=f"{stated['now']} is {fact.validity.value if fact else 'unknown'}: where {arm} stands is not sure",
        where=stated["now"],
        clears=f"the next motion reads the joints first, such as HOLD {hand_in_words(arm)} FOR 1 SEC",
    )
    raise Refused(unsure)


def bind_stated_facts(task: BindTask) -> BoundStep:
    """The facts stated by the command, as a report (A24); the analyzer judges and writes them."""
    context = task.data.context
    if not context.stated:
        raise refused_program("the command states no facts", "a script for a command that states facts")
    facts = {key: _now(task, value) for key, value in context.stated.items()}
    report = EndReport(
        primitive=task.data.primitive_id,
        performer=STATED_BY,
        reason=StopReason.GOAL,
        at_s=0.0,  # no motion, so there is no arm time
        duration_s=0.0,
        facts=facts,
    )
    return BoundStep(report=report, evaluation=EvaluationContext(context=context, step=task.data.step), note="stated")


def bind_procedure(task: BindTask) -> BoundStep:
    known = task.program.procedures
    name = task.data.step.name
    if name not in known:
        raise suggestions.unknown("procedure", name, known)
    return PROCEDURES[known[name]](task)


def open_hand(task: BindTask) -> BoundStep:
    """Open the empty hand to the width required before a grasp."""
    held = task.query.holding(task.arm)
    if held:
        message = f"{task.arm} already holds {held}"
        raise Refused(Refusal(reason=RefusalReason.STATE, message=message, clears=f"let go of {held}"))
    return hand_motion(task, "open")


def grasp_plan(task: BindTask) -> BoundStep:
    """Bindings of the plan, with joint values solved again for objects that have moved since planning."""
    return BoundStep(bindings=replan.replan(task.query, task.arm, task.data.bindings), note="the plan")


Action = Callable[[BindTask], BoundStep]

ACTIONS: dict[str, Action] = {
    "motion": bind_motion,
    "hand": bind_hand,
    "still": bind_still,
    "assign": bind_assignment,
    "stated": bind_stated_facts,
    "procedure": bind_procedure,
    "look": bind_look,
}
PROCEDURES: dict[str, Action] = {"open_hand": open_hand, "grasp_plan": grasp_plan}
