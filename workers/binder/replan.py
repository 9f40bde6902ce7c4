"""Replanning at execution time: joint values for objects that have moved since planning. Pure."""

from __future__ import annotations

import math

from rtc.protocol.messages import Binding
from rtc.protocol.outcomes import Refusal
from rtc.robot import geometry
from workers.elaborator.backtrack import PLAN
from workers.planning.world_query import WorldQuery

MOVED_M = 0.0005  # smaller displacements need no replanning
MOVED_RAD = math.radians(0.2)


def replan(query: WorldQuery, arm: str, bindings: dict[str, Binding]) -> dict[str, Binding] | Refusal:
    """Joint values (rad), nearest to the old ones, for each planned pose whose object has moved; or a refusal."""
    model = query.model.arms[arm]
    margin_rad = math.radians(query.cell.numbers.joint_margin_deg)
    replanned: dict[str, Binding] = {}
    for name, planned in bindings.items():
        old = bindings.get(name.removesuffix(PLAN))
        if not name.endswith(PLAN) or planned.pose is None or old is None or old.joints is None:
            continue
        frame = query.frame(planned.frame) if planned.frame else geometry.IDENTITY
        wanted = geometry.compose(frame, planned.pose)
        was = model.fk(old.joints)
        if geometry.distance(wanted, was) < MOVED_M and geometry.angle(wanted, was) < MOVED_RAD:
            continue
        found = model.ik(wanted, old.joints, margin_rad)
        if not found:
            why = model.why_no_ik(wanted, margin_rad)
            assert why is not None
            return why
        replanned[name.removesuffix(PLAN)] = Binding(joints=found[0].tolist())
    return replanned
