"""A predicted end report: of an arm at rest, and what its primitive says about a stop reason."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from rtc.model.robot.quintic import Hermite
from rtc.protocol.messages import EndReport
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import JointTrajectory, Primitive
from rtc.spatial.geometry import Array
from workers.planning.world_query import WorldQuery

NO_FORCE = [0.0] * 6
HALVINGS = 24  # of the time of a path, to find the place of a touch within some micrometres


class Course(NamedTuple):
    """How the tcp of an arm moves along a path: its pose (world) at a time."""

    tcp: Callable[[float], Array]
    duration_s: float


def first_s(duration_s: float, is_past: Callable[[float], bool]) -> float:
    """The time at which something becomes true that is true from then on, at the end at the latest."""
    before_s, after_s = 0.0, duration_s
    for _ in range(HALVINGS):
        middle_s = 0.5 * (before_s + after_s)
        before_s, after_s = (before_s, middle_s) if is_past(middle_s) else (middle_s, after_s)
    return after_s


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
        hand=query.hand_planned_with(arm),
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
