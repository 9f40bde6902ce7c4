"""How hard a hand meets a rigid body, and the speed at which a force that was asked for can be kept. Pure.

An arm stops in the tick that feels a contact, yet that tick has taken up the momentum of the hand: effective mass times
speed, within one tick of the servo. No threshold changes that; a lower speed does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rtc.geometry import Floats
from rtc.messages import ScriptContext
from rtc.robot.kinematics import ArmModel


class Impact(NamedTuple):
    """Of a motion with a force that was asked for."""

    asked_n: float
    felt_n: float  # on a rigid body at the speed of the motion
    kept_m_s: float  # the speed below which what is felt stays within what was asked


def asked_force_n(context: ScriptContext) -> float | None:
    """The least force that the sentence names as a limit: FORCE-LIMIT, UNLESS FORCE EXCEEDS."""
    conditions = [reflex.condition for reflex in context.reflexes]
    said = [c.quantity.value for c in conditions if c.measure == "FORCE" and c.bound == "above" and c.quantity]
    if context.limits.force_n is not None:
        said.append(context.limits.force_n)
    return min(said, default=None)


def impact(
    arm: ArmModel, joints: Floats, way_m: Floats, carried_kg: float, impact_s: float, speed_m_s: float, asked_n: float
) -> Impact | None:
    """Of the tcp going along `way_m` (world axes) from `joints`; None: it goes nowhere."""
    way = np.asarray(way_m, dtype=float)
    length_m = float(np.linalg.norm(way))
    if length_m < 1e-6:
        return None
    momentum = (arm.effective_mass_kg(joints, way / length_m) + carried_kg) / impact_s  # N per m/s
    return Impact(asked_n, momentum * speed_m_s, asked_n / momentum)
