"""A predicted end report: of an arm at rest, and what its primitive says about a stop reason."""

from __future__ import annotations

from typing import Any

from rtc.model.robot.quintic import Hermite
from rtc.protocol.messages import EndReport
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import JointTrajectory, Primitive
from workers.planning.world_query import WorldQuery

NO_FORCE = [0.0] * 6


def at_rest(
    query: WorldQuery, arm: str, primitive: str, reason: StopReason, joints: list[float], duration_s: float
) -> EndReport:
    """The report of an arm that rests at these joint values (rad), `duration_s` after its primitive has begun."""
    pose = query.model.arms[arm].fk(joints).tolist()
    return EndReport(
        primitive=primitive,
        performer=arm,
        reason=reason,
        at_s=0.0,
        duration_s=duration_s,
        joints=list(joints),
        slides=[n for n, slides in enumerate(query.model.arms[arm].slides) if slides],
        tcp_pose=pose,
        wrench=NO_FORCE,
        trip_pose=pose,
        trip_wrench=NO_FORCE,
        hand_width_m=query.hand_width(arm),
        hand_force_n=query.hand_force(arm),
    )


def replaced(report: EndReport, **fields: Any) -> EndReport:
    """The report with other values of these fields."""
    return EndReport(**{**{name: getattr(report, name) for name in report.__struct_fields__}, **fields})


def curve(path: JointTrajectory) -> Hermite:
    """The joint values of a path at any time."""
    return Hermite(path.time_s, path.positions, path.velocities, path.accelerations)


def predicate_of(made: Primitive, reason: StopReason) -> object:
    """The predicate that would end the primitive with this reason; None if it has none, such as a refusal."""
    return next((stop.when for stop in made.stop_functions if stop.reason is reason), None)
