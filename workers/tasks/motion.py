"""A motion of the arm in the current world: checked, planned, assembled, and set beside other motions. Pure."""

from __future__ import annotations

import itertools
import math

import msgspec
import numpy as np
from msgspec.structs import replace

from rtc.protocol.messages import BoundStep, EvaluationContext, Limits, MoveStep, PathStep, SharedStep
from rtc.protocol.outcomes import StopReason, refuse_if
from rtc.protocol.primitive_id import command_of
from rtc.protocol.units import in_words
from workers.conditions import prediction
from workers.conditions.stop_conditions import Values
from workers.planning import in_seat, scenes, segments, shared_hold, step_target, trust
from workers.planning.motion import beside
from workers.planning.motion import plan as plans
from workers.planning.motion.plan import Motion
from workers.planning.motion.request import PlanningRequest
from workers.planning.motion.timing import SpeedLimits
from workers.planning.segments import Target
from workers.tasks import assemble, impact, targets, two_arms
from workers.tasks.bind_task import BindTask, RuledTask, unknown_in_program
from workers.tasks.impact import Keeping

DETOUR = 3.0  # a relative step in joint space is reported if the hand travels this many times its distance
DETOUR_POSTURES = 21  # at which the way of the hand is measured


def bind_motion(task: BindTask) -> BoundStep:
    """The step as a motion of the arm. Raises Refused."""
    step = task.data.step.of_kind(PathStep)
    ruled = task.under(step.stop)
    target = allowed_target(ruled, step)
    keep = impact.keeping(ruled, target, touches=_may_touch(ruled, step, target))
    request = planning_request(ruled, keep.speed_m_s, step.space)
    motion = _planned(ruled, step, request, target, keep)
    bound = _assembled(ruled, step, motion, keep)
    return _beside_others(task, request, bound, follows=_may_wait(ruled, step))


def _may_touch(task: RuledTask, step: PathStep, target: Target) -> bool:
    """Whether a touch is possible on this way: on each line, curve and search, and where the stop class touches.

    An empty hand that goes straight back, away from what it let go, comes where its own wrist has been.
    """
    if task.stop_class.away and not task.held and impact.goes_back(task, step.space, target):
        return False
    return step.space != "move_joint" or task.stop_class.touches


def motion_to_share(task: RuledTask, step: SharedStep) -> Motion:
    """The motion of a step that the operator shares, at the speed of its class. Raises Refused."""
    speed_m_s = task.values["speed_m_s"]
    request = planning_request(task, speed_m_s, step.space)
    return _planned(task, step, request, allowed_target(task, step), Keeping(speed_m_s))


def allowed_target(task: RuledTask, step: PathStep) -> Target:
    """Where the step goes, if the arm may go there."""
    query, clears = task.query, task.program.clears
    if step.space not in segments.SPACES:
        raise unknown_in_program("space", step.space, segments.SPACES)
    refuse_if(trust.why_uncertain(query, task.arm, step, clears))
    partner = task.data.context.partner if step.space == segments.BOTH else ""
    shared_hold.refuse_alone(query, task.arm, partner, clears)
    target = targets.target_of(task, step)
    in_seat.refuse_other_way(query, task.arm, step, query.tcp(task.arm), target.pose, clears)
    return target


def planning_request(task: RuledTask, speed_m_s: float, space: str) -> PlanningRequest:
    """The planning problem of a motion in this space, except its target."""
    query, context, stop_class, values = task.query, task.data.context, task.stop_class, task.values
    touches = stop_class.touches or bool(context.object or context.target)
    scene = scenes.scene_of(
        query,
        task.arm,
        task.limits,
        touching=context.object if stop_class.touches and task.held != context.object else "",
        seated=stop_class.seated,
        ignore_suspect=stop_class.away,
        exempt=[name for name in (context.object, context.target) if name],
        unsure=space not in segments.STRAIGHT or not touches,
    )
    pace = SpeedLimits(speed_m_s, values["laden_acceleration_m_s2" if task.held else "acceleration_m_s2"])
    request = scenes.planning_request(
        query, task.arm, scene, task.limits, pace, math.radians(values["joint_margin_deg"])
    )
    both = space == segments.BOTH and context.partner
    return replace(request, partner=query.model.arms[context.partner]) if both else request


def _planned(task: RuledTask, step: PathStep, request: PlanningRequest, target: Target, keep: Keeping) -> Motion:
    """The timed motion, as slow as its force and its duration demand. Raises Refused."""
    motion = impact.kept(task, segments.plan_segment(request, step.space, target, step.way), keep)
    return motion if step.takes_s is None else plans.slowed_to(motion, step.takes_s)


def _assembled(task: RuledTask, step: PathStep, motion: Motion, keep: Keeping) -> BoundStep:
    """The bound step of a planned motion, with the part of a second arm."""
    context, query = task.data.context, task.query
    remarks = [*filter(None, (keep.remark, _speed_not_kept(context.limits, task.values), _detour(task, step, motion)))]
    evaluation = EvaluationContext(
        context=context,
        step=msgspec.structs.replace(task.data.step, way=None),
        arm=task.arm,
        goal_pose=motion.goal_pose.tolist(),
        remark="; ".join(remarks),
        held=task.held,
        no_contact_is_failure=StopReason.GOAL not in step.expect,
        start_joints=[float(q) for q in query.joints(task.arm)],
    )
    against = targets.against_motion(query.tcp(task.arm).tolist(), motion) if step.space == "move_task" else None
    note = "; ".join((*remarks, *motion.notes))
    expected = prediction.of_path(
        task.values, step, motion.timed.duration_s, speed_m_s=keep.speed_m_s, laden=bool(task.held)
    )
    bound = assemble.of_arm(task, motion.timed.trajectory(), evaluation, expected, against, note)
    bound = msgspec.structs.replace(bound, remark="; ".join(remark.partition(": ")[0] for remark in remarks))
    return bound if motion.partner is None else two_arms.with_partner(task, bound, motion.partner)


def _speed_not_kept(limits: Limits, values: Values) -> str:
    """The remark that the SPEED of the sentence is looser than that of the step, which is not changed; else empty."""
    if limits.speed_m_s is None or limits.speed_m_s <= values["speed_m_s"]:
        return ""
    asked, own = in_words(limits.speed_m_s, "m/s"), in_words(values["speed_m_s"], "m/s")
    return f"SPEED {asked} changes nothing: this step moves at {own} at most"


def _detour(task: BindTask, step: PathStep, motion: Motion) -> str:
    """The remark that a relative step takes the hand a much longer way through joint space; else empty."""
    if step.space != "move_joint" or step.to != step_target.HERE:
        return ""
    postures = motion.timed.at(np.linspace(0.0, motion.timed.duration_s, DETOUR_POSTURES))[:, 0]
    places = [task.query.model.arms[task.arm].fk(joints)[:3] for joints in postures]
    way_m = sum(math.dist(here, there) for here, there in itertools.pairwise(places))
    step_m = math.dist(places[0], places[-1])
    if way_m <= DETOUR * step_m:
        return ""
    return f"the hand travels {way_m:.2f} m to be {in_words(round(step_m, 3), 'm')} away"


def _may_wait(task: RuledTask, step: PathStep) -> bool:
    """Whether the motion may stand on its way, and be bound again from there: it goes to a fixed place, and neither
    touches anything nor is expected to end otherwise."""
    fixed = step.to != step_target.HERE and isinstance(step, MoveStep) and not step.through
    return fixed and not task.stop_class.touches and step.expect == [StopReason.GOAL]


def _beside_others(task: BindTask, request: PlanningRequest, bound: BoundStep, *, follows: bool) -> BoundStep:
    """The step with its space, and with the conditions of its start, if other arms move or may soon do so. `follows`:
    conditions on its way too."""
    made = bound.primitive
    if made is None or not (task.query.moving or task.data.others):
        return bound
    made = msgspec.structs.replace(made, space_mm=beside.space_of(request, made))
    bound = msgspec.structs.replace(bound, primitive=made)
    conditions = beside.start_conditions(request, made, task.query.moving, follows=follows)
    if not conditions:
        return bound
    awaited = ", ".join(command_of(condition.primitive) for condition in conditions)
    return msgspec.structs.replace(
        bound,
        primitive=msgspec.structs.replace(made, start_after=conditions),
        limit_s=bound.limit_s + max(condition.within_s for condition in conditions),
        note=f"{bound.note}; starts when {awaited} has left the space that it needs",
    )
