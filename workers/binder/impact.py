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
