"""Impact force of a hand on a rigid body, and the speed at which a force limit can be kept. Pure.

An arm stops in the servo tick that measures a contact, but within that tick the contact absorbs the hand's momentum:
effective mass times speed. A lower threshold cannot reduce this force; a lower speed can.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rtc.protocol.messages import ScriptContext
from rtc.robot.geometry import Floats
from rtc.robot.kinematics import ArmModel
from workers.binder.bind_task import BindTask
from workers.binder.stop_conditions import Values
from workers.planning.segments import Target


class Impact(NamedTuple):
    """Impact of a motion with a force limit."""

    limit_n: float
    felt_n: float  # force (N) on a rigid body at the motion's speed
    safe_speed_m_s: float  # maximum speed that keeps the force within `limit_n`


def asked_force_n(context: ScriptContext) -> float | None:
    """The lowest force limit of the command (N), from FORCE-LIMIT and UNLESS FORCE EXCEEDS; None without one."""
    conditions = [reflex.condition for reflex in context.reflexes]
    limits_n = [c.quantity.value for c in conditions if c.measure == "FORCE" and c.bound == "above" and c.quantity]
    if context.limits.force_n is not None:
        limits_n.append(context.limits.force_n)
    return min(limits_n, default=None)


def impact(
    arm: ArmModel, joints: Floats, way_m: Floats, carried_kg: float, contact_s: float, speed_m_s: float, limit_n: float
) -> Impact | None:
    """Impact of the tcp moving by `way_m` (world frame, m) from `joints` (rad); None for a zero displacement."""
    way = np.asarray(way_m, dtype=float)
    length_m = float(np.linalg.norm(way))
    if length_m < 1e-6:
        return None
    force_per_speed = (arm.effective_mass_kg(joints, way / length_m) + carried_kg) / contact_s  # N per m/s
    return Impact(limit_n, force_per_speed * speed_m_s, limit_n / force_per_speed)


def impact_of(task: BindTask, target: Target, values: Values, held: str) -> Impact | None:
    """Expected impact of this motion on a rigid body; None if the command sets no force limit."""
    limit_n = asked_force_n(task.data.context)
    if limit_n is None:
        return None
    arm, joints = task.query.model.arms[task.arm], task.query.joints(task.arm)
    goal: Floats = arm.fk(target.joints or joints) if target.pose is None else target.pose
    if target.poses is not None:
        goal = target.poses[1]  # the direction in which it begins
    way = [there - here for there, here in zip(goal[:3], task.query.tcp(task.arm)[:3], strict=True)]
    load = task.query.load(task.arm) if held else None
    carried_kg = load.mass_kg if load else 0.0
    return impact(arm, joints, way, carried_kg, values["impact_s"], values["speed_m_s"], limit_n)


def pace_of(
    task: BindTask, values: Values, hit: Impact | None, *, touches: bool, firmly: bool
) -> tuple[float, list[str]]:
    """The speed (m/s), with a note if the force limit has reduced it or cannot be kept at it.

    A path without expected contact (`touches`) is not slowed. `firmly`: a speed stated in the command is reduced too.
    """
    speed_m_s, limits = values["speed_m_s"], task.data.context.limits
    if hit is None or hit.felt_n <= hit.limit_n:
        return speed_m_s, []
    felt = (
        f"at {speed_m_s * 1e3:.3g} mm/s the first millisecond on a rigid body is felt with {hit.felt_n:.0f} N; "
        f"{hit.limit_n:g} N is kept up to {hit.safe_speed_m_s * 1e3:.3g} mm/s"
    )
    stated = limits.speed_m_s is not None or limits.speed_ratio is not None
    if not touches or (stated and not firmly):
        return speed_m_s, [f"not slowed: {felt}"]
    slow_m_s = max(hit.safe_speed_m_s, values["slowest_m_s"])
    faster = "a higher force allows more speed" if firmly else "MAINTAIN SPEED keeps another speed"
    return slow_m_s, [f"slowed to {slow_m_s * 1e3:.3g} mm/s: {felt}; {faster}"]
