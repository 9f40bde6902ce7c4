"""Replanning at execution time: poses and joint values for what has moved since planning, in the world or in the hand.
Pure."""

from __future__ import annotations

import math

import msgspec

from rtc.protocol.advice import again_after
from rtc.protocol.messages import Binding
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.planning.motion import ik
from workers.planning.world_query import WorldQuery
from workers.tasks.anchor import POSE_OF_JOINTS

MOVED_M = 0.0005  # smaller displacements need no replanning
MOVED_RAD = math.radians(0.2)
AGAIN = "it is planned with what was measured"


def current_pose(query: WorldQuery, arm: str, binding: Binding) -> Array:
    """The tcp pose of a pose binding now, world frame. With an object that lies otherwise in the hand than planned, the
    tcp goes where the object comes to the planned place. Raises Refused if the object is not in the hand any more."""
    assert binding.pose is not None
    pose = geometry.compose(query.pose(binding.frame) if binding.frame else geometry.IDENTITY, binding.pose)
    if binding.grasp is None:
        return pose
    held = query.holding(arm)
    grasp = query.grasp(held) if held else None
    if grasp is None:
        message = f"{arm} does not hold the object any more"
        raise Refused.because(RefusalReason.STATE, message, clears="take it again")
    if geometry.distance(grasp, binding.grasp) < MOVED_M and geometry.angle(grasp, binding.grasp) < MOVED_RAD:
        return pose
    return geometry.compose(geometry.compose(pose, binding.grasp), geometry.inverse(grasp))


def _planned_before(why: Refusal) -> Refusal:
    """The refusal of a plan that does not fit what was measured after it: a new one rests on that."""
    message = f"planned before the last look, which has found it elsewhere: {why.message}"
    return msgspec.structs.replace(why, message=message, clears=[*again_after(AGAIN), *why.clears])


def replan(query: WorldQuery, arm: str, bindings: dict[str, Binding]) -> tuple[dict[str, Binding], list[str]]:
    """Joint values (rad), nearest to the old ones, for each pose planned for this arm that is elsewhere now; and which
    solver has found them, if the program leaves a choice. Raises Refused."""
    model, solvers = query.model.arms[arm], query.algorithms.ik
    margin_rad = math.radians(query.cell.numbers.joint_margin_deg)
    replanned: dict[str, Binding] = {}
    notes: dict[str, None] = {}
    for name, planned in bindings.items():
        old = bindings.get(name.removesuffix(POSE_OF_JOINTS))
        if not name.endswith(POSE_OF_JOINTS) or planned.pose is None or old is None or old.joints is None:
            continue
        if planned.arm not in ("", arm):
            continue  # a step of that arm restates it
        wanted = current_pose(query, arm, planned)
        was = model.fk(old.joints)
        if geometry.distance(wanted, was) < MOVED_M and geometry.angle(wanted, was) < MOVED_RAD:
            continue
        postures = ik.solutions(solvers, model, wanted, old.joints, margin_rad)
        if not postures.found:
            raise Refused(_planned_before(ik.why_none(solvers, model, wanted, margin_rad)))
        replanned[name.removesuffix(POSE_OF_JOINTS)] = Binding(joints=postures.found[0].tolist(), arm=planned.arm)
        notes |= dict.fromkeys(postures.notes)
    return replanned, list(notes)
