"""Binder worker function: (program, one step, world) -> a primitive with its expected result, or a refusal.

Called once per step, nominal or corrective (R135), with the current bindings. Fixed parameters are used unchanged;
parameters measured in an earlier step are used in the same way (R136). A step without motion yields bindings instead.
The program defines the meaning of a script's words; this module knows no skill.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from rtc.programs import expressions, named_algorithms
from rtc.programs.extension_names import PERFORMERS
from rtc.programs.loader import decode
from rtc.programs.schema import BinderProgram
from rtc.protocol import messages as m
from rtc.protocol.messages import BinderInput, Binding, BoundStep, EvaluationContext
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused
from rtc.protocol.primitive import HoldStill
from rtc.protocol.primitive_id import command_of, seed_of
from rtc.world.model import World
from workers.conditions import installed_phases
from workers.conditions.prediction import Expected
from workers.mechanisms import joined, refuse_missing
from workers.mechanisms.collision_advice import advise_on_collision
from workers.planning import shared_hold, step_target, suggestions
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery
from workers.tasks import assemble, replan, targets
from workers.tasks.bind_task import BindTask, refused_program, unknown_in_program
from workers.tasks.motion import bind_motion

INPUT = BinderInput
NEEDS_WORLD = True
NEEDS_CELL = True


def compile(program: bytes) -> BinderProgram:
    """Check the program. Raises ProgramError."""
    document = decode(program, BinderProgram)
    named_algorithms.refuse_missing(document)
    refuse_missing(document)
    return document


def run(compiled: BinderProgram, cell: CellModel | None, world: World | None, data: BinderInput) -> BoundStep | Refusal:
    """Bind the step to the current world."""
    assert cell is not None
    assert world is not None
    query = WorldQuery(cell, world, seed_of(command_of(data.primitive_id)), data.moving, compiled)
    try:
        step = step_target.counted_from_now(data.step, query, data.context.object)
        bound = _bound(BindTask(compiled, query, msgspec.structs.replace(data, step=step)))
        return installed_phases.applied(compiled.phases, data, bound)
    except Refused as refused:
        arm, limits, leaves = data.step.arm or data.context.arm, data.context.limits, data.step.leaves_seat
        advised = advise_on_collision(refused.refusal, query, arm, compiled.clears, limits, leaves_seat=leaves)
        infeasible = advised.reason is RefusalReason.INFEASIBLE
        return advised.offering(shared_hold.offer(query, data.context) if infeasible else "")
    except expressions.ExpressionError as error:
        lacking = "a figure that the step needs must be in the script, the program or the cell"
        return refused_program(str(error), lacking).refusal


def _bound(task: BindTask) -> BoundStep:
    step = task.data.step
    if step.who not in PERFORMERS:
        raise unknown_in_program("performer of steps", step.who, PERFORMERS)
    return ACTIONS[step.action if isinstance(step, m.InstalledStep) else type(step)](task)


# --- rest ------------------------------------------------------------------------------------------------


def bind_still(task: BindTask) -> BoundStep:
    """Stay for the time of the step, but no longer than the TIME-LIMIT allows. Raises Refused."""
    step, query, left_s = task.data.step.of_kind(m.HoldStep), task.query, task.time_left_s
    ruled = task.under(step.stop)
    if left_s is not None and left_s <= 0.0:
        raise assemble.refused_time(task, 0.0)
    duration_s = step.duration_s if left_s is None else min(step.duration_s, left_s)
    known = query.trusts(f"{task.arm}.joints")  # otherwise only the report will contain the position that the arm holds
    evaluation = EvaluationContext(
        context=task.data.context,
        step=step,
        arm=task.arm,
        goal_pose=query.tcp(task.arm).tolist() if known and not step.presses else None,
        held=task.held,
        start_joints=list(query.joints(task.arm)),
    )
    return assemble.of_arm(ruled, HoldStill(duration_s=duration_s), evaluation, Expected(duration_s))


# --- steps that move nothing -----------------------------------------------------------------------------


def bind_assignment(task: BindTask) -> BoundStep:
    """A binding computed from other bindings, measured or planned: GP = 0.5*(GP1 + GP2)."""
    step = task.data.step.of_kind(m.LetStep)
    given: dict[str, float | list[float]] = {}
    for name in expressions.names(step.value):
        binding = targets.binding(task, name)
        given[name] = binding.number if binding.number is not None else targets.world_pose(task, binding, name)
    try:
        value = expressions.evaluate(step.value, given)
    except expressions.ExpressionError as error:
        message = f"{step.name} = {step.value}: {error}"
        raise Refused.because(RefusalReason.INFEASIBLE, message, where=step.name, clears="measure again") from error
    binding = Binding(pose=value) if isinstance(value, list) else Binding(number=value)
    return BoundStep(bindings={step.name: binding}, note=f"{step.name} = {step.value}")


def bind_procedure(task: BindTask) -> BoundStep:
    known = task.program.procedures
    name = task.data.step.of_kind(m.ProcedureStep).name
    if name not in known:
        raise suggestions.unknown("procedure", name, known)
    return PROCEDURES[known[name]](task)


def grasp_plan(task: BindTask) -> BoundStep:
    """Bindings of the plan, with joint values solved again for objects that have moved since planning."""
    bindings, notes = replan.replan(task.query, task.arm, task.data.bindings)
    return BoundStep(bindings=bindings, note="; ".join(("the plan", *notes)))


Action = Callable[[BindTask], BoundStep]

ACTIONS: dict[type[m.BaseStep] | str, Action] = {
    **dict.fromkeys((m.MoveStep, m.CircleStep, m.PatternStep), bind_motion),
    m.HoldStep: bind_still,
    m.LetStep: bind_assignment,
    m.ProcedureStep: bind_procedure,
    **joined(lambda mechanism: mechanism.actions),
}
PROCEDURES: dict[str, Action] = {"grasp_plan": grasp_plan, **joined(lambda mechanism: mechanism.procedures)}
