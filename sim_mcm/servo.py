"""One arm's servo: from the motion wanted, through the law in use, to torques within the motors' limits.

Pure: it holds what was last wanted and the law, nothing else. Torque in the fingers is the hand's (see `hand`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtc.geometry import Array
from rtc.primitive import ControlLaw
from rtc.robot.kinematics import ArmModel
from sim_mcm import control_laws


class Servo:
    def __init__(self, model: ArmModel, joints: Sequence[float]) -> None:
        self._arm = model
        self._laws = control_laws.known()
        self._name = ControlLaw()
        self._law = control_laws.make(self._name, model, self._laws)
        self._effort = model.limits.effort
        still = np.zeros(len(joints))
        self._wanted: tuple[Array, Array, Array] = (np.asarray(joints, dtype=float), still, still)

    def use_law(self, law: ControlLaw) -> None:
        """ValueError, in words, when there is no such law or its gains will not do; the old one then stays."""
        if law != self._name:
            self._law = control_laws.make(law, self._arm, self._laws)
            self._name = law

    def want(self, joints: Sequence[float], velocities: Sequence[float], accelerations: Sequence[float]) -> None:
        self._wanted = (np.array(joints), np.array(velocities), np.array(accelerations))

    def torque(self, joints: Sequence[float], velocities: Sequence[float]) -> Array:
        """For this tick, clipped to what the motors can (N.m)."""
        torque = self._law.torque(self._wanted, np.array(joints), np.array(velocities))
        clipped: Array = np.minimum(np.maximum(torque, -self._effort), self._effort)
        return clipped
