"""The primitive of a bound step, T = (P, M, F, R): from its trajectory, and from what is expected of it. Pure."""

from __future__ import annotations

import msgspec

from rtc.protocol import causes
from rtc.protocol.messages import BoundStep, EvaluationContext
from rtc.protocol.outcomes import RefusalReason, Refused, StopReason
from rtc.protocol.primitive import (
    MAX_S,
    ForceAbove,
    HandMotion,
    HoldStill,
    JointTrajectory,
    Load,
    Look,
    Primitive,
    Reporting,
    StopFunction,
    TeleopMotion,
    Trajectory,
    Vector,
)
from rtc.protocol.primitive_id import command_of
from workers.conditions import stop_conditions
from workers.conditions.prediction import Expected
from workers.conditions.stop_conditions import Values
from workers.planning import trust
from workers.tasks import compliance, targets
from workers.tasks.bind_task import BindTask, RuledTask


def of_arm(
    task: RuledTask,
    trajectory: Trajectory,
    evaluation: EvaluationContext,
    expected: Expected,
    against: Vector | None = None,
    note: str = "",
) -> BoundStep:
    """The bound step of an arm or its hand. `against`: unit vector (tool frame) of a force that opposes the motion.

    Raises Refused.
    """
    left_s = None if isinstance(trajectory, HoldStill) else task.time_left_s  # a rest has been shortened to it
    if left_s is not None and expected.seconds > left_s:
        raise refused_time(task, expected.seconds)
    path_s = trajectory.duration_s if isinstance(trajectory, JointTrajectory) else 0.0  # also if no touch ends it
    values = _with_time_limit(task.values, max(expected.seconds, path_s), left_s)
    rows = [*task.stop_class.stops, *(task.program.holding if _keeps(task, trajectory) else [])]
    requested = stop_conditions.from_command(task.data, task.query, values, rows, against=against)
    stops = stop_conditions.stop_functions(rows, values, against, requested, targets.turn_line(task))
    if isinstance(trajectory, JointTrajectory | TeleopMotion):
        stops += stop_conditions.maintained(task.data, task.query, values)
    if isinstance(trajectory, TeleopMotion) and values["near_m"]:
        stops += stop_conditions.near(task.data, task.query, values["near_m"])
    lets_go = isinstance(trajectory, HandMotion) and trajectory.width_m > task.query.hand_width(task.arm)
    # A hand that closes on something off its middle presses more with one finger. One that opens may have held it
    # more strongly before this command.
    squeezable = bool(task.held) and not lets_go
    if squeezable:
        stops += stop_conditions.squeezed(task.data, values)
    load = None if lets_go else task.query.load(task.arm)
    control_law = compliance.control_law(task, trajectory, load)
    _refuse_weight(task, load)
    made = Primitive(
        id=task.data.primitive_id,
        performer=task.arm,
        trajectory=trajectory,
        stop_functions=stops,
        control_law=control_law,
        reporting=stop_conditions.reporting(task.data, task.query, values, rows),
        hand=task.query.hand_planned_with(task.arm),
    )
    evaluation = msgspec.structs.replace(
        evaluation,
        predicted_s=expected.seconds,
        within_s=expected.within_s,
        force_n=_least_limit_n(stops),
        squeeze_n=stop_conditions.squeeze_limit_n(task.data, values) if squeezable else 0.0,
    )
    return _bound(task, made, evaluation, values, note)


def of_camera(task: RuledTask, look: Look, camera: str, evaluation: EvaluationContext) -> BoundStep:
    """The bound step of the camera that reports. Raises Refused."""
    values = _with_time_limit(task.values, evaluation.predicted_s, task.data.context.limits.time_s)
    asked = task.data.context.report
    made = Primitive(
        id=task.data.primitive_id,
        performer=camera,
        trajectory=look,
        stop_functions=stop_conditions.stop_functions(
            task.stop_class.stops, values, None, [], stop_conditions.TurnLine(None, None)
        ),
        reporting=Reporting(items=asked.items, every_s=asked.every_s) if asked else Reporting(),
    )
    return _bound(task, made, evaluation, values)


def _bound(
    task: RuledTask, made: Primitive, evaluation: EvaluationContext, values: Values, note: str = ""
) -> BoundStep:
    return BoundStep(
        subsystem=_subsystem_of(task, made),
        primitive=made,
        evaluation=evaluation,
        predicted_s=evaluation.predicted_s,
        limit_s=values["report_factor"] * values["time_limit_s"] + values["report_margin_s"],
        note=note,
    )


def _least_limit_n(stops: list[StopFunction]) -> float:
    """The force at which F ends the motion as a fault; 0: a touch is to end it, or no force does."""
    if any(stop.reason is StopReason.CONTACT for stop in stops):
        return 0.0
    return min((stop.when.limit_n for stop in stops if isinstance(stop.when, ForceAbove)), default=0.0)


def _keeps(task: RuledTask, trajectory: Trajectory) -> bool:
    """Whether a held object is monitored: while the arm moves, if it is known how it is held.

    An arm that may have lost what it held backs off nevertheless.
    """
    if not task.held or isinstance(trajectory, HandMotion):
        return False
    own = command_of(task.data.primitive_id)
    return trust.distrusted(task.query, f"{task.held}.grasp", {}, own) is None


def _with_time_limit(values: Values, predicted_s: float, most_s: float | None) -> Values:
    """The figures with the time limit of the primitive (s), at most `most_s`."""
    limit_s = values["time_factor"] * predicted_s + values["time_margin_s"]
    limit_s = limit_s if most_s is None else min(limit_s, most_s)
    _refuse_endless(limit_s)
    return {**values, "time_limit_s": limit_s}


def _refuse_endless(limit_s: float) -> None:
    """Refuse a step whose time limit (s) no primitive can have: a speed near zero, or a time of years."""
    if limit_s <= MAX_S:
        return
    raise Refused.because(
        RefusalReason.INFEASIBLE,
        f"this step would need a time limit of {limit_s:.3g} s; {MAX_S:g} s is the longest possible",
        clears="more speed or a greater force, if the sentence limits them; a shorter way or time",
        cause=causes.TooLong(predicted_s=limit_s, limit_s=MAX_S),
    )


def _refuse_weight(task: RuledTask, load: Load | None) -> None:
    payload_kg = task.query.cell.arm(task.arm).payload_kg
    if load is None or load.mass_kg <= payload_kg:
        return
    raise Refused.because(
        RefusalReason.INFEASIBLE,
        f"{task.held} weighs {load.mass_kg:g} kg; {task.arm} carries {payload_kg:g} kg at most",
        clears=f"let go of {task.held}; if it is lighter, correct its mass",
        cause=causes.TooHeavy(mass_kg=load.mass_kg, limit_kg=payload_kg, arm=task.arm),
    )


def refused_time(task: BindTask, predicted_s: float) -> Refused:
    left_s = task.time_left_s or 0.0
    most_s, moved_s = task.data.context.limits.time_s or 0.0, task.data.moved_s
    left = f", of which {max(left_s, 0.0):.3g} s are left" if moved_s else ""
    return Refused.because(
        RefusalReason.INFEASIBLE,
        f"this step takes {predicted_s:.3g} s; the time limit is {most_s:g} s{left}",
        clears="more time, or more speed",
        cause=causes.TooLong(predicted_s=predicted_s, limit_s=most_s, moved_s=moved_s),
    )


def _subsystem_of(task: RuledTask, made: Primitive) -> str:
    """The subsystem that performs a primitive. Raises Refused if its performers belong to several."""
    cell = task.query.model.cell
    owners = {name: cell.subsystem_of(name) for name in made.performers}
    if len(set(owners.values())) > 1:
        words = ", ".join(f"{name} belongs to {owner}" for name, owner in owners.items())
        raise Refused.because(
            RefusalReason.INFEASIBLE,
            f"one motion cannot have performers of two subsystems: {words}",
            where=task.data.step.label,
            clears="a sentence for each",
        )
    return owners[made.performer]
